"""A planned capture on the arm: carries out what a campaign proposes and tells it what happened.

Every report to the campaign is in the journal before the next proposal is asked for. The same reports
give the same proposals, so a resumed session replays them and goes on in the middle of a plan; where
that is not possible (the arm was moved, poses were withdrawn, more poses are wanted) a new campaign
begins with the poses that count. Prints nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from hardware.arm import ArmSnapshot, Watch
from operator_app.errors import GuardError
from operator_app.planning.task import CANDIDATES, STOP_MARGIN_RAD, require_closed_chain
from operator_app.session.store.stored_calibration import NO_WAY_BACK
from operator_app.session.workflow.campaign_replay import (
    DivergedError,
    built,
    is_on_the_way,
    replayed,
    still_fits,
)
from operator_app.session.workflow.drive_box import require_in_box
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from operator_app.units.figure import WHOLE_DEGREES
from operator_app.units.numbers import joints_named
from solver.arrays import FloatArray
from solver.design.actions import Capture, ChangeDrives, Finished, GoTo, path_watch
from solver.design.campaign import Campaign
from solver.design.campaign_settings import Phase
from solver.design.stop_rule import PrecisionStatus

SAME_BRANCH_RAD = float(np.deg2rad(6.0))
"""With the drives back in place, free joints farther off are on another branch of the loop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Weak:
    """A parameter known less well than was requested: sigmas in rad or m, None when undetermined."""

    name: str
    sigma: float | None
    requested: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignEnd:
    """How a planned capture ended.

    `complete`: all planned poses were taken or the precision asked for was reached. `text` says why
    it ended; `weak` what is short of the request, the worst first.
    """

    complete: bool
    text: str
    weak: tuple[Weak, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """Where a move of these drives began: angles of all joints (n,), rad."""

    drives: tuple[int, ...]
    q_rad: FloatArray


class PlannedCapture:
    """The planned capture of one session.

    Parameters
    ----------
    session
        Connected, its fixture checked.
    drives
        Joints to begin with; a campaign that is under way knows its own.
    listener
        Hears of moves, poses and decisions.
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
        self._listener, self._say = listener, listener.told
        self._candidates = candidates
        self._chosen = drives
        self._campaign: Campaign | None = None
        self._moved = False
        self._ended: CampaignEnd | None = None

    def ready(self) -> tuple[int, ...]:
        """Go through the journal and look where the arm is; return the joints to put into position mode.

        Nothing moves.
        """
        session = self._session
        log = session.state.campaign
        self._campaign, self._moved, self._ended = None, False, None
        if not log.begun or not still_fits(session.state, self._wanted()):
            return self._chosen
        if log.ended:
            # What could not be finished is tried again, with the poses there are.
            self._ended = _end_of(log.ended) if log.ended["complete"] else None
            return self._chosen
        try:
            campaign = replayed(session.model, session.fixture, session.state)
        except DivergedError:
            self._say("The journal's plan cannot be repeated: planning anew from its poses.")
            return self._chosen
        here = session.arm.snapshot().positions_rad
        if is_on_the_way(campaign.propose(), campaign.at_rad, here):
            self._campaign = campaign
            return campaign.drives
        if campaign.phase is Phase.EXPLORING:
            self._campaign, self._moved = campaign, True
            return campaign.drives
        self._say("The arm is not where it was: planning anew from here.")
        return self._chosen

    @property
    def complete(self) -> bool:
        """After `ready`: whether the journal has all poses of the plan already."""
        return self._ended is not None

    @property
    def goes_on_from_here(self) -> bool:
        """After `ready`: whether the arm stands where it was left, or nothing is to be done."""
        return self._ended is not None or (self._campaign is not None and not self._moved)

    def run(self, taken_one: Callable[[], None] = lambda: None) -> CampaignEnd:
        """Carry the campaign out, with the joints of `ready` in position mode.

        `taken_one` is called after each pose, before the plan hears of it and may be made anew: there is a way back.

        Raises
        ------
        GuardError
            While exploring, the arm was moved out of its box, or does not come back to where it was.
        Cancelled
            The operator ended a move; `ready` and `run` go on.
        """
        session = self._session
        if self._ended is not None:
            return self._ended
        if self._campaign is None:
            again = bool(session.state.campaign.begun)
            self._campaign = self._begun()
            self._campaign.propose()
            if again and self._campaign.phase is Phase.EXPLORING:
                # Without a plan from here, its first step leads straight back to where the session began.
                require_in_box(session)
        elif self._moved:
            self._bring_back(self._campaign)
        campaign = self._campaign
        while True:
            phase, made = campaign.phase, campaign.plan
            action = campaign.propose()
            self._tell(campaign, phase, made is not campaign.plan)
            match action:
                case Finished():
                    return self._end(action)
                case Capture():
                    pose = session.capture(planned=action.planned)
                    wanted = session.state.wanted_poses(session.procedure.capture)
                    self._listener.pose_captured(session.state, wanted)
                    taken_one()
                    campaign.captured(pose.mean_rad)
                case ChangeDrives():
                    self._say(f"{_capital(action.why)}: they drive from here.")
                    session.set_modes(action.drives)
                    session.settle()
                    q = session.arm.snapshot().positions_rad
                    data = {"drives": list(action.drives), "q_rad": q.tolist()}
                    session.record("campaign_drives", data)
                    campaign.observe(q)
                case GoTo():
                    self._move(campaign, action)

    def to_first(self) -> tuple[str, tuple[Stop, ...]]:
        """Go to the first captured pose on ways the plan knows to be clear; nothing is reported.

        Returns
        -------
        Why it was not reached ("" if it was), and where the drives stood before each move: the way back.
        """
        campaign = None if self._moved else self._campaign
        first = self._session.state.used_poses[0].mean_rad
        moves = None if campaign is None else campaign.way_to(first)
        if campaign is None or moves is None:
            return NO_WAY_BACK, ()
        session, stops = self._session, list[Stop]()
        self._listener.going(None)
        for move in moves:
            if isinstance(move, ChangeDrives):
                session.set_modes(move.drives)
                session.settle()
                continue
            here = session.arm.snapshot().positions_rad
            stops.append(Stop(drives=session.position_joints, q_rad=here))
            moved = session.go_to(move.targets_rad, _on_path(campaign, move))
            if not moved.reached:
                return moved.reason, tuple(stops)
        return "", tuple(stops)

    def retrace(self, stops: tuple[Stop, ...]) -> None:
        """Go back the way `to_first` came, with the drives it had, to where the plan goes on."""
        session = self._session
        for stop in reversed(stops):
            if session.position_joints != stop.drives:
                session.set_modes(stop.drives)
                session.settle()
            moved = session.go_to({j: float(stop.q_rad[j - 1]) for j in stop.drives})
            if not moved.reached:
                raise GuardError(
                    f"the arm does not come back to where it was before: {moved.reason}",
                    "look at what is in the way, then go on with this session",
                )

    # -- carrying out ----------------------------------------------------------------------------

    def _move(self, campaign: Campaign, action: GoTo) -> None:
        """Move and report; a move that the operator ended is no report."""
        session = self._session
        self._listener.going(action)
        moved = session.go_to(action.targets_rad, _on_path(campaign, action))
        if not moved.reached:
            session.settle()
            self._say(f"Stopped short: {moved.reason}.")
        q = session.arm.snapshot().positions_rad
        session.record(
            "campaign_move",
            {
                "targets_rad": {str(j): v for j, v in action.targets_rad.items()},
                "why": action.why,
                "q_rad": q.tolist(),
                "stopped": moved.reason,
            },
        )
        campaign.observe(q, moved.reason)

    def _bring_back(self, campaign: Campaign) -> None:
        """Take the drives to where the journal left them, straight: nobody has spoken for a way from elsewhere."""
        session, last = self._session, campaign.at_rad
        require_in_box(session)
        self._say("The arm is not where it was: going back there first.")
        self._listener.going(None)
        moved = session.go_to({j: float(last[j - 1]) for j in campaign.drives})
        session.settle()
        off = np.abs(session.arm.snapshot().positions_rad - last)
        if not moved.reached or float(off.max()) > SAME_BRANCH_RAD:
            joint = int(np.argmax(off)) + 1
            raise GuardError(
                f"the arm does not come back to where this session left it: joint {joint} is "
                f"{WHOLE_DEGREES(float(off.max())).with_unit} off"
                + ("" if moved.reached else f" ({moved.reason})"),
                "bring it near its home by hand, then resume again; or start a new session",
            )
        self._moved = False

    def _tell(self, campaign: Campaign, before: Phase, planned: bool) -> None:  # noqa: FBT001
        """Say what the campaign decided."""
        if not planned or campaign.plan is None or campaign.estimate is None:
            return
        count = len(campaign.readings_rad)
        first = before is Phase.EXPLORING and not any(
            p.planned for p in self._session.state.used_poses
        )
        head = f"Explored {count} poses" if first else "Planned again"
        left = len(campaign.plan.visits)
        self._say(
            f"{head} ({campaign.estimate.text}): {left} pose{'s' if left != 1 else ''} to take, "
            f"{joints_named(campaign.drives)} {'drives' if len(campaign.drives) == 1 else 'drive'}."
        )

    def _end(self, action: Finished) -> CampaignEnd:
        weak: tuple[Weak, ...] = ()
        decision = action.decision
        if decision is not None and decision.standing is not PrecisionStatus.REACHED:
            weak = tuple(
                Weak(
                    name=w.name,
                    sigma=w.sigma if np.isfinite(w.sigma) else None,
                    requested=w.requested,
                )
                for w in decision.weak
            )
        end = CampaignEnd(complete=action.complete, text=action.text, weak=weak)
        self._session.record(
            "campaign_ended",
            {
                "complete": end.complete,
                "text": end.text,
                "weak": [
                    {"name": w.name, "sigma": w.sigma, "requested": w.requested} for w in weak
                ],
            },
        )
        return end

    # -- beginning and replaying -----------------------------------------------------------------

    def _wanted(self) -> dict[str, Any]:
        """What a campaign depends on beside its readings."""
        own = self._session.procedure
        return {
            "poses": own.capture.poses,
            "requested": dict(own.capture.requested),
            "unsensed_joints": list(own.unsensed_joints),
            "samples": own.capture.samples_per_pose,
            "seed": own.capture.seed,
            "candidates": self._candidates,
        }

    def _begun(self) -> Campaign:
        """Begin a campaign with the poses that count, from where the arm stands; recorded first."""
        session = self._session
        sets = session.state.drive_sets if session.procedure.position_joints is None else ()
        here = session.read().mean_rad
        earlier = session.state.campaign.begun
        session.record(
            "campaign",
            {
                **self._wanted(),
                "drive_sets": [
                    list(self._chosen),
                    *(list(d) for d in sets if d != self._chosen),
                ],
                "start_rad": earlier.get("start_rad", here.tolist()),
                "at_rad": here.tolist(),
                "captured": [p.number for p in session.state.used_poses],
            },
        )
        return built(session.model, session.fixture, session.state)


def _on_path(campaign: Campaign, move: GoTo) -> Watch:
    """Judge a move under way by the path it was planned on."""
    on_path = path_watch(
        move.trace_rad, move.tolerance_rad, campaign.task.ranges.within(STOP_MARGIN_RAD)
    )

    def watch(snapshot: ArmSnapshot) -> str | None:
        return on_path(snapshot.positions_rad)

    return watch


def _end_of(data: Mapping[str, Any]) -> CampaignEnd:
    """Return the end that the journal holds."""
    weak = tuple(Weak(**w) for w in data["weak"])
    return CampaignEnd(complete=data["complete"], text=data["text"], weak=weak)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
