"""Planned capture: carries out the actions that a campaign proposes, and reports the results to it.

Each result is in the journal before the next proposal is made. The campaign is deterministic, so that a resumed session
can replay the journal and continue the plan. If the arm was moved, poses were excluded or more poses are requested, a
new campaign starts with the used poses.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from hardware.arm import Watch
from operator_app.errors import GuardError
from operator_app.planning.exploration import RANGE_END_MARGIN_RAD
from operator_app.planning.task import require_closed_chain
from operator_app.session.store.state import CampaignLog
from operator_app.session.store.stored_calibration import NO_WAY_BACK
from operator_app.session.workflow.campaign_replay import (
    ReplayDivergedError,
    campaign_from_log,
    can_continue_from,
    log_is_current,
    replay_campaign,
)
from operator_app.session.workflow.drive_selection import require_in_box
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from operator_app.units import WHOLE_DEGREES, joints_named, plural
from solver.design.actions import Action, Capture, ChangeDrives, Finished, GoTo, path_watch
from solver.design.campaign import Campaign
from solver.design.plan import CANDIDATES
from solver.design.stop_rule import WeakParameter

SAME_BRANCH_RAD = float(np.deg2rad(6.0))
"""Largest deviation of a joint after the drives have moved back; if it is larger, the loop is on another branch."""


class PlannedCapture:
    """The planned capture of a session that is connected and whose fixture has been checked.

    `drives`: drive joints to use if a new campaign starts.
    `listener`: receives moves, poses and decisions.
    `campaign` (attribute): policy that plans the poses; None until `ready` or `run` has set it.
    """

    def __init__(
        self,
        session: Session,
        drives: tuple[int, ...],
        listener: Listener,
        *,
        candidates: int = CANDIDATES,
    ) -> None:
        require_closed_chain(session.fixture)
        self._session = session
        self._listener, self._say = listener, listener.report
        self._candidates = candidates
        self._chosen = drives
        self.campaign: Campaign | None = None
        self._moved = False
        self._ended: Finished | None = None

    def ready(self) -> tuple[int, ...]:
        """Prepare to continue the recorded campaign if possible, else to start a new one; return the drive joints."""
        session = self._session
        log = session.state.campaign
        self.campaign, self._moved, self._ended = None, False, None
        if not log.begun or not log_is_current(session.state, self._required_settings()):
            return self._chosen
        if log.ended:
            # An incomplete campaign is tried again, with the poses so far.
            self._ended = _end_from_journal(log.ended) if log.ended["complete"] else None
            return self._chosen
        try:
            with self._planning():
                campaign = replay_campaign(session.model, session.fixture, session.state)
        except ReplayDivergedError:
            self._say("The recorded plan cannot be replayed: making a new plan from its poses.")
            return self._chosen
        q_rad = session.arm.snapshot().positions_rad
        moved = not can_continue_from(self._next_action(campaign), campaign.at_rad, q_rad)
        if not moved or campaign.exploring:
            self.campaign, self._moved = campaign, moved
            return campaign.drives
        self._say("The arm was moved: making a new plan from its present position.")
        return self._chosen

    @property
    def complete(self) -> bool:
        """Whether the recorded campaign is complete; valid after `ready`."""
        return self._ended is not None

    @property
    def continues_in_place(self) -> bool:
        """Whether the recorded campaign can continue from the arm's position, or is complete; valid after `ready`."""
        return self._ended is not None or (self.campaign is not None and not self._moved)

    def run(self, after_pose: Callable[[], None] = lambda: None) -> Finished:
        """Carry out the campaign and return how it ended; the joints returned by `ready` must be in position mode.

        Calls `after_pose` after each pose, while the path back to the first pose is still known. An arm that was moved
        during exploration first returns to its last position. Raises GuardError if that fails or the arm is outside its
        box, and Cancelled if the operator ended a move; call `ready` and `run` again to continue.
        """
        session = self._session
        if self._ended is not None:
            return self._ended
        if self.campaign is None:
            self.campaign = self._new_campaign()
        elif self._moved:
            self._move_back(self.campaign)
        campaign = self.campaign
        while True:
            exploring, plan = campaign.exploring, campaign.plan
            action = self._next_action(campaign)
            if campaign.plan is not plan:
                self._report_plan(campaign, after_exploring=exploring)
            match action:
                case Finished():
                    return self._end(action)
                case Capture():
                    pose = session.capture(planned=action.planned)
                    total = session.state.required_poses(session.procedure.capture)
                    self._listener.pose_captured(session.state, total)
                    after_pose()
                    campaign.captured(pose.mean_rad)
                case ChangeDrives():
                    reason = action.why[:1].upper() + action.why[1:]
                    self._say(f"{reason}. They are the drive joints from now on.")
                    session.set_modes(action.drives)
                    session.reader.settle()
                    q = session.arm.snapshot().positions_rad
                    data = {"drives": list(action.drives), "q_rad": q.tolist()}
                    session.record("campaign_drives", data)
                    campaign.observe(q)
                case GoTo():
                    self._move(campaign, action)

    def to_first(self) -> tuple[str, list[Mapping[int, float]]]:
        """Move to the first used pose along paths of the plan; these moves are not reported to the campaign.

        Returns why the pose was not reached ("" if it was), and the drives' angles (rad, by joint) at the start of
        each move.
        """
        campaign = None if self._moved else self.campaign
        first = self._session.state.used_poses[0].mean_rad
        moves = None if campaign is None else campaign.moves_to(first)
        if campaign is None or moves is None:
            return NO_WAY_BACK, []
        session, stops = self._session, list[Mapping[int, float]]()
        self._listener.going(None)
        for move in moves:
            if isinstance(move, ChangeDrives):
                session.set_modes(move.drives)
                session.reader.settle()
                continue
            q_rad = session.arm.snapshot().positions_rad
            stops.append({j: float(q_rad[j - 1]) for j in session.state.position_joints})
            outcome = session.go_to(move.targets_rad, _path_watch(campaign, move))
            if not outcome.reached:
                return outcome.reason, stops
        return "", stops

    # -- carrying out ----------------------------------------------------------------------------

    @contextmanager
    def _planning(self) -> Iterator[None]:
        self._listener.planning(active=True)
        try:
            yield
        finally:
            self._listener.planning(active=False)

    def _next_action(self, campaign: Campaign) -> Action:
        with self._planning():
            return campaign.propose()

    def _move(self, campaign: Campaign, action: GoTo) -> None:
        """Move the arm, record the move in the journal and report it to the campaign.

        Raises Cancelled if the operator ends the move; the move is then neither recorded nor reported.
        """
        session = self._session
        self._listener.going(action)
        outcome = session.go_to(action.targets_rad, _path_watch(campaign, action))
        if not outcome.reached:
            session.reader.settle()
            self._say(f"Stopped short: {outcome.reason}.")
        q = session.arm.snapshot().positions_rad
        session.record(
            "campaign_move",
            {
                "targets_rad": {str(j): v for j, v in action.targets_rad.items()},
                "why": action.why,
                "q_rad": q.tolist(),
                "stopped": outcome.reason,
            },
        )
        campaign.observe(q, outcome.reason)

    def _move_back(self, campaign: Campaign) -> None:
        """Move the drives straight back to their last position in the journal; the arm must be inside the box."""
        session, last = self._session, campaign.at_rad
        require_in_box(session)
        self._say("The arm was moved: going back to its last position first.")
        self._listener.going(None)
        outcome = session.go_to({j: float(last[j - 1]) for j in campaign.drives})
        session.reader.settle()
        deviation = np.abs(session.arm.snapshot().positions_rad - last)
        if not outcome.reached or float(deviation.max()) > SAME_BRANCH_RAD:
            joint = int(np.argmax(deviation)) + 1
            raise GuardError(
                f"the arm does not return to its last position in this session: joint {joint} is "
                f"{WHOLE_DEGREES(float(deviation.max())).with_unit} off"
                + ("" if outcome.reached else f" ({outcome.reason})"),
                "move it close to its home by hand, then resume again; or start a new session",
            )
        self._moved = False

    def _report_plan(self, campaign: Campaign, *, after_exploring: bool) -> None:
        if campaign.plan is None or campaign.estimate is None:
            return
        count = len(campaign.readings_rad)
        first = after_exploring and not any(p.planned for p in self._session.state.used_poses)
        head = f"Explored {count} poses" if first else "New plan"
        self._say(
            f"{head} ({campaign.estimate.text}): {plural(len(campaign.plan.visits), 'pose')} to take, "
            f"{joints_named(campaign.drives)} {'drives' if len(campaign.drives) == 1 else 'drive'}."
        )

    def _end(self, action: Finished) -> Finished:
        data = {
            "complete": action.complete,
            "text": action.text,
            "weak": [
                {
                    "name": w.name,
                    "sigma": w.sigma if np.isfinite(w.sigma) else None,
                    "requested": w.requested,
                }
                for w in action.weak
            ],
        }
        self._session.record("campaign_ended", data)
        return action

    # -- beginning and replaying -----------------------------------------------------------------

    def _required_settings(self) -> dict[str, Any]:
        own = self._session.procedure
        return {
            "poses": own.capture.poses,
            "requested": dict(own.capture.requested),
            "unsensed_joints": list(own.unsensed_joints),
            "samples": own.capture.samples_per_pose,
            "seed": own.capture.seed,
            "candidates": self._candidates,
        }

    def _new_campaign(self) -> Campaign:
        """Record and return a new campaign that contains the used poses and starts at the current position.

        Raises GuardError, and records nothing, if the campaign must explore again but the arm is outside the box.
        """
        session = self._session
        sets = session.state.drive_sets if session.procedure.position_joints is None else ()
        q_rad = session.reader.read().mean_rad
        earlier = session.state.campaign.begun
        begun = {
            **self._required_settings(),
            "drive_sets": [list(self._chosen), *(list(d) for d in sets if d != self._chosen)],
            "start_rad": earlier.get("start_rad", q_rad.tolist()),
            "at_rad": q_rad.tolist(),
            "captured": [p.number for p in session.state.used_poses],
        }
        state = replace(session.state, campaign=CampaignLog(begun=begun))
        campaign = campaign_from_log(session.model, session.fixture, state)
        self._next_action(campaign)
        if earlier and campaign.exploring:
            # The first step of a new exploration leads straight back to the start of the session.
            require_in_box(session)
        session.record("campaign", begun)
        return campaign


def _path_watch(campaign: Campaign, move: GoTo) -> Watch:
    on_path = path_watch(move.trace_rad, campaign.task.ranges.within(RANGE_END_MARGIN_RAD))
    return lambda snapshot: on_path(snapshot.positions_rad)


def _end_from_journal(data: Mapping[str, Any]) -> Finished:
    weak = tuple(
        WeakParameter(
            name=w["name"],
            sigma=math.inf if w["sigma"] is None else w["sigma"],
            requested=w["requested"],
            forecast=math.nan,  # not in the journal
        )
        for w in data["weak"]
    )
    return Finished(complete=data["complete"], text=data["text"], weak=weak)
