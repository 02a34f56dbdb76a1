"""A planned calibration as a policy: explore, calibrate, plan with the estimate, visit poses, stop.

`propose` returns the next action; `observe` takes the result of a move, and `captured` a measured pose. The policy
never touches an arm: the session carries out the actions and keeps the journal. The same readings lead to the same
proposals.
"""

from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from solver.arrays import FloatArray
from solver.closing import measure_with_fixed, newton_step
from solver.design.actions import (
    Action,
    Capture,
    ChangeDrives,
    Finished,
    GoTo,
    moves_along,
    straight_move,
)
from solver.design.exploration import Explorer
from solver.design.interim import InterimEstimate, implicit_interim
from solver.design.paths import Leg
from solver.design.plan import PlanningTask, PosePlan, information_of, make_plan
from solver.design.stop_rule import StopDecision, stop_decision
from solver.errors import SolverError
from solver.loops.closure import poses_needed

SPARE_POSES = 4
"""Number of poses, in addition to the minimum, that must be captured before an interim calibration is tried."""
MOST_BLOCKED = 8
"""Number of planned moves that may be stopped early; one more ends the campaign."""
MOST_UNREACHED = 12
"""Number of consecutive chosen poses that may have no path; one more ends the campaign."""
EASIER_LEVERAGE = 0.7
"""Share to which the lower limit of the drives' leverage (`MotionLimits`) is reduced if no pose can be reached."""
REPLAN_SHIFT_RAD = float(np.deg2rad(0.5))
"""A new plan is made when a new estimate changes the predicted angles of the planned poses by more than this."""
NEXT_TO_RAD = 0.5
"""Largest distance (Euclidean, all joints) from a captured pose to the candidate where the last move to it starts."""

BACK = "to a captured pose"


class Campaign:
    """Policy of a campaign. Repeat: call `propose`, carry out the action, report it with `observe` or `captured`.

    `task`: planning task with drive sets, the first of which is in position mode now.
    `start_rad`, `at_rad` (n,): readings at the start and at the arm's present pose (by default `start_rad`).
    `poses`: number of planned poses, in addition to those of the exploration.
    `requested`: requested standard deviations (rad, m) by parameter name; None: no request.
    `captured` (m, n): readings at poses of an earlier campaign on the same loop that are still valid. If they suffice
    for a trusted estimate, there is no exploration. `taken`: number of planned poses among `captured`.
    `exploring` (attribute): true until the first plan is made or the campaign ends.
    """

    def __init__(
        self,
        *,
        task: PlanningTask,
        start_rad: FloatArray,
        poses: int,
        requested: Mapping[str, float] | None = None,
        captured: FloatArray | None = None,
        taken: int = 0,
        at_rad: FloatArray | None = None,
    ) -> None:
        if not task.drive_sets:
            raise ValueError("a campaign needs the drive joints at the start")
        self.task = task
        self.poses, self._requested = poses, requested
        self.exploring = True
        self.plan: PosePlan | None = None
        self.estimate: InterimEstimate | None = None
        self.drives = task.drive_sets[0]
        self._calibrate = implicit_interim(task.model, task.noise)
        self._explorer = Explorer(start_rad=start_rad, drives=self.drives, ranges=task.ranges)
        self._q = np.array(start_rad if at_rad is None else at_rad)
        self._before = self._q
        self._readings: list[FloatArray] = [] if captured is None else [*np.array(captured)]
        self._queue: deque[Action] = deque()
        self._taken = taken
        self._blocked: list[FloatArray] = []
        self._backing = 0
        self._unreached: list[FloatArray] = []
        self._visits: deque[int] = deque()
        self._node = 0
        if self._readings:
            self._interim()

    @property
    def at_rad(self) -> FloatArray:
        """Readings (n,) at the end of the last move or capture that was reported."""
        return self._q.copy()

    @property
    def readings_rad(self) -> FloatArray:
        """All captured poses (m, n), exploration included."""
        return np.array(self._readings).reshape(-1, len(self._q))

    def propose(self) -> Action:
        """Return the next action; it stays the same until its end is reported. The last action is `Finished`."""
        while not self._queue:
            if self.exploring:
                self._explore()
            else:
                self._next_visit()
        return self._queue[0]

    def observe(self, q_rad: FloatArray, stopped: str = "") -> None:
        """Report that a proposed move or change of drives ended at `q_rad` (n,); `stopped` is why it ended early."""
        action = self._queue[0] if self._queue else None
        if not isinstance(action, GoTo | ChangeDrives):
            raise ValueError("no move was proposed")  # noqa: TRY004 - a wrong call, not a wrong type
        self._queue.popleft()
        self._before, self._q = self._q, np.array(q_rad)
        if isinstance(action, ChangeDrives):
            self.drives = action.drives
            return
        if self.exploring:
            self._explorer.observe(q_rad, stopped)
            if stopped:
                self._queue.clear()
        elif stopped:
            self._plan_around_stop(action, stopped)
        else:
            self._backing = 0

    def captured(self, q_rad: FloatArray) -> None:
        """Report the mean readings `q_rad` (n,) of a proposed capture."""
        action = self._queue[0] if self._queue else None
        if not isinstance(action, Capture):
            raise ValueError("no capture was proposed")  # noqa: TRY004 - a wrong call, not a wrong type
        self._queue.popleft()
        self._q = np.array(q_rad)
        self._readings.append(np.array(q_rad))
        self._taken += action.planned
        if action.planned:
            self._unreached.clear()
        self._interim()

    # -- exploring -------------------------------------------------------------------------------

    def _explore(self) -> None:
        if self.estimate is not None and self.estimate.trusted and self._try_plan():
            return
        self._queue += self._explorer.propose()
        if self._queue:
            return
        if self._explorer.failure:
            self._finish(self._explorer.failure)
        elif self.estimate is None:
            self._finish(f"exploration gave only {len(self._readings)} poses, too few to calibrate")
        elif not self._try_plan():
            self._finish(
                f"the estimate from the explored poses allows no plan: {self.estimate.text}"
            )

    # -- calibrating and planning ----------------------------------------------------------------

    def _interim(self) -> None:
        P = len(self.task.model.parameters)
        needed = poses_needed(P, self.task.model.equations_per_pose) + SPARE_POSES
        if len(self._readings) < needed:
            return
        try:
            self.estimate = self._calibrate(self.readings_rad)
        except SolverError:
            # Too few poses, or too similar ones: keep the previous estimate, and take more.
            return
        if self._shift() > REPLAN_SHIFT_RAD:
            self.plan = None

    def _shift(self) -> float:
        """Return the largest change, rad, of the planned poses' predicted angles since the plan was made."""
        if self.plan is None or self.estimate is None or not self.plan.visits:
            return 0.0
        index = list(self.plan.visits)
        manifold = self.plan.manifold
        error = self.task.model.loop(self.estimate.x, manifold.q[index], manifold.u[index])
        still = measure_with_fixed(self.drives, manifold.q.shape[-1])
        return max(float(np.abs(step).max(initial=0.0)) for step in newton_step(error, still))

    def _try_plan(self) -> bool:
        if self.estimate is None:
            return False
        remaining = self.poses - self._taken
        if remaining <= 0:
            self.exploring = False
            return True
        others = (d for d in self.task.drive_sets or () if d != self.drives)
        tasks = [replace(self.task, drive_sets=(self.drives, *others))]
        if self._taken:
            # A pose slightly nearer to a singularity, or fewer poses, are better than none.
            limits = self.task.limits
            eased = limits.eased(EASIER_LEVERAGE)
            tasks.append(replace(tasks[0], limits=eased, pose_leverage=limits.least_leverage))
        for task in tasks:
            with suppress(ValueError):
                self.plan = make_plan(
                    task,
                    self.estimate.x,
                    self._q,
                    remaining,
                    captured=self.readings_rad,
                    covariance=self.estimate.covariance,
                    avoid_rad=self._blocked + self._unreached,
                )
                self.exploring = False
                self._visits = deque(self.plan.visits)
                self._node = 0
                return True
        return False

    # -- visiting --------------------------------------------------------------------------------

    def _next_visit(self) -> None:
        is_over = self._taken >= self.poses
        if self.plan is None and not is_over and not self._try_plan():
            self._finish(
                f"{self._taken} of {self.poses} planned poses: "
                "no further pose can be reached safely from here"
            )
            return
        decision = self._stop_decision()
        if is_over:
            more = "" if decision is None else f"; {decision.text}"
            text = f"all {self._taken} planned poses are taken{more}"
            self._finish(text, complete=True, decision=decision)
            return
        if decision is not None and decision.stop:
            self._finish(decision.text, complete=not decision.weak, decision=decision)
            return
        plan = self.plan
        if plan is None or not self._visits:
            self.plan = None
            return
        target = self._visits.popleft()
        if (route := self._route(plan, target)) is None:
            # The other poses may still be reached; a later plan replaces this pose by one at a distance from it.
            self._unreached.append(plan.manifold.q[target])
            if len(self._unreached) > MOST_UNREACHED:
                self._finish(
                    f"{self._taken} of {self.poses} planned poses: "
                    "no safe path to any further pose was found"
                )
            return
        goal = f"planned pose {self._taken + 1}"
        self._queue += moves_along(route, self.drives, goal, of=f" of {self.poses}")
        self._queue.append(Capture(planned=True))
        self._node = target

    def _route(self, plan: PosePlan, target: int) -> tuple[Leg, ...] | None:
        """Return a path from the current pose to a candidate of `plan`; None if no safe path is found.

        The path keeps at least 80 % of the planning margin to the ends of the ranges. Candidates keep the whole margin,
        but on the way from one to the next, a joint may come nearer to an end than at both.
        """
        return plan.graph.route(
            self.task.ranges.within(0.8 * np.asarray(self.task.margin_rad)),
            source=self._node,
            target=target,
            drives=self.drives,
        )

    def moves_to(self, captured_rad: FloatArray) -> tuple[GoTo | ChangeDrives, ...] | None:
        """Return moves from the current pose to a captured pose (n,); None if no safe path is found.

        These moves are not proposals: the caller must not report them to the campaign, and must go back along them
        before the campaign continues. During exploration the result is one straight move.
        """
        if self.exploring:
            return (straight_move(captured_rad, self.drives, BACK),)
        if (plan := self.plan) is None:
            return None
        # The arm was at the captured pose, so the candidate next to it is safe if a path leads there.
        away = np.linalg.norm(plan.manifold.q - captured_rad, axis=-1)
        away[~plan.graph.reachable(self._node)] = np.inf
        target = int(np.argmin(away))
        if away[target] > NEXT_TO_RAD:
            return None
        if (route := self._route(plan, target)) is None:
            return None
        moves = moves_along(route, self.drives, "a captured pose")
        drives = route[-1].drives if route else self.drives
        return (*moves, straight_move(captured_rad, drives, BACK))

    def _stop_decision(self) -> StopDecision | None:
        if not self._requested or self.plan is None:
            return None
        manifold = self.plan.manifold
        known, candidates = information_of(self.task, manifold.x, self.readings_rad, manifold)
        return stop_decision(
            known,
            candidates,
            self._requested,
            poses_left=self.poses - self._taken,
            allowed=self.plan.allowed,
        )

    def _plan_around_stop(self, action: GoTo, stopped: str) -> None:
        self._queue.clear()
        self._blocked.append(self._q.copy())
        self.plan = None
        if len(self._blocked) > MOST_BLOCKED or self._backing > 2:
            self._finish(f"planned moves are stopped repeatedly: {stopped}")
            return
        self._backing += 1
        reason = f"back to the start of the move ({stopped})"
        self._queue.append(straight_move(self._before, tuple(action.targets_rad), reason))

    def _finish(
        self, text: str, *, complete: bool = False, decision: StopDecision | None = None
    ) -> None:
        self.exploring = False
        weak = () if decision is None else decision.weak
        self._queue.append(Finished(complete=complete, weak=weak, text=text))
