"""What a report is about: one session's facts, poses and calibration. Knows no HTML and no arm to talk to."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np

from fixtures.errors import FixtureError
from operator_app.calibration.checks import Checks, check
from operator_app.calibration.solve import Solution, calibrate
from operator_app.config.procedure import Procedure
from operator_app.errors import SessionError
from operator_app.session.journal import Event
from operator_app.session.state import CapturedPose, SessionState, replay
from solver.arrays import FloatArray
from solver.errors import SolverError, UnidentifiableDirection, UnidentifiableError
from solver.estimators.estimate import Estimate
from solver.judging.rvdt import RvdtVerdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """Everything a report says, before it is put into words.

    Attributes
    ----------
    name
        Of the session folder.
    procedure
        With the arm that was really there.
    opened_utc, last_utc
        First and last event of the journal.
    events
        How many events the journal holds.
    simulated
        Whether the drives said that they are virtual.
    settings
        What was chosen beside the procedure file.
    poses
        All captured poses, excluded ones included.
    pose_set_sha256
        Digest of the poses that were used.
    solution
        None when the poses cannot determine every parameter; `unidentifiable` says which, then.
    beside
        The implicit solution where `solution` is the paper's; None where there is none.
    checks
        Second opinions on the implicit solution.
    drift_from_journal
        Largest difference (rad, m) between this solution and the one the session recorded for the same
        poses; None when it recorded none.
    """

    name: str
    procedure: Procedure
    serial_number: str
    opened_utc: str
    last_utc: str
    events: int
    torn: str
    simulated: bool
    settings: Mapping[str, object]
    modes: tuple[str, ...]
    poses: tuple[CapturedPose, ...]
    pose_set_sha256: str
    software_version: str
    solution: Solution | None
    unidentifiable: tuple[UnidentifiableDirection, ...]
    beside: Solution | None
    checks: Checks
    drift_from_journal: float | None

    @property
    def paper(self) -> Estimate | None:
        """By the paper's estimator; None when joints are unsensed."""
        return None if self.solution is None else self.solution.paper

    @property
    def implicit_solution(self) -> Solution | None:
        """Solution by the implicit estimator, chosen or beside the chosen one."""
        if self.solution is not None and self.solution.estimate.estimator == "implicit":
            return self.solution
        return self.beside

    @property
    def implicit(self) -> Estimate | None:
        """By the implicit estimator."""
        found = self.implicit_solution
        return None if found is None else found.estimate

    @property
    def rvdt(self) -> tuple[RvdtVerdict, ...]:
        """One verdict an RVDT joint, where the poses allow it."""
        return () if self.solution is None else self.solution.rvdt

    @property
    def used(self) -> tuple[CapturedPose, ...]:
        """Poses the solution is made of, in the order of its rows."""
        used = tuple(p for p in self.poses if not p.excluded)
        dropped = () if self.solution is None else self.solution.dropped_flipped
        return tuple(p for k, p in enumerate(used) if k not in dropped)

    @property
    def flipped(self) -> tuple[int, ...]:
        """Numbers of poses that were left out because they lie on the other branch."""
        used = tuple(p for p in self.poses if not p.excluded)
        dropped = () if self.solution is None else self.solution.dropped_flipped
        return tuple(used[k].number for k in dropped)

    @property
    def readings_rad(self) -> FloatArray:
        """Readings of the poses used, (m, n), rad."""
        return np.array([p.mean_rad for p in self.used])

    @property
    def unsensed_joints(self) -> tuple[int, ...]:
        """Joints whose readings were not used."""
        if self.solution is None:
            return self.procedure.unsensed_joints
        return self.solution.model.unsensed_joints


def subject_of_session(
    name: str,
    events: Sequence[Event],
    procedure: Procedure,
    *,
    torn: str = "",
    estimator: str | None = None,
    unsensed_joints: tuple[int, ...] | None = None,
) -> Subject:
    """Solve a session again from its journal.

    Parameters
    ----------
    procedure
        The one the session follows, with the arm that was really there.
    estimator, unsensed_joints
        None: as the session last solved them, else as the procedure says.

    Raises
    ------
    SessionError, TooFewPosesError, FixtureRefusedError
        There is nothing that could be reported.
    """
    state = replay((e.name, e.data, e.utc) for e in events)
    if not state.used_poses:
        raise SessionError(f"{name} has no pose to report on", "capture poses first")
    recorded = state.solved
    joints = _recorded_unsensed(recorded, procedure) if unsensed_joints is None else unsensed_joints
    chosen = estimator or str(recorded.get("estimator") or procedure.estimator)
    if joints and chosen == "paper":
        raise SessionError(
            "the paper's estimator eliminates the hinge angle only (eqs. 10-13)",
            "use --estimator implicit with --unsensed",
        )
    solution, blind = None, tuple[UnidentifiableDirection, ...]()
    try:
        solution = _solve(state, procedure, chosen, joints)
    except UnidentifiableError as error:
        blind = error.directions
    beside = None if solution is None else _beside(solution, state, procedure, joints)
    judged = beside if beside is not None else solution
    implicit = judged is not None and judged.estimate.estimator == "implicit"
    return Subject(
        name=name,
        procedure=procedure,
        serial_number=state.serial_number,
        opened_utc=state.opened_utc,
        last_utc=events[-1].utc,
        events=len(events),
        torn=torn,
        simulated=_simulated(events),
        settings=state.settings,
        modes=state.modes,
        poses=state.poses,
        pose_set_sha256=state.pose_set().sha256(),
        software_version=version("sarcal"),
        solution=solution,
        unidentifiable=blind,
        beside=beside,
        checks=check(judged, procedure.arm, procedure.fixture.fixture, state.pose_set())
        if judged is not None and implicit
        else Checks(),
        drift_from_journal=None if solution is None else _drift(solution, recorded),
    )


def _solve(
    state: SessionState, procedure: Procedure, estimator: str, joints: tuple[int, ...]
) -> Solution:
    return calibrate(
        procedure.arm,
        procedure.fixture.fixture,
        state.pose_set(),
        estimator=estimator,
        unsensed_joints=joints,
        length_tolerance_m=procedure.length_tolerance_m,
        limits=procedure.acceptance,
    )


def _beside(
    solution: Solution, state: SessionState, procedure: Procedure, joints: tuple[int, ...]
) -> Solution | None:
    """Return the implicit solution beside one by the paper's estimator."""
    if solution.estimate.estimator == "implicit":
        return None
    try:
        found = _solve(state, procedure, "implicit", joints)
    except (SolverError, FixtureError):
        # It is shown for comparison only; the report says that there is none.
        return None
    same = found.dropped_flipped == solution.dropped_flipped
    return found if same else None


def _recorded_unsensed(recorded: Mapping[str, object], procedure: Procedure) -> tuple[int, ...]:
    """Joints without an offset among the parameters that the session recorded."""
    found = recorded.get("parameters")
    if not isinstance(found, Mapping):
        return procedure.unsensed_joints
    free = {entry.name for entry in procedure.arm.free}
    return tuple(
        j
        for j in range(1, procedure.arm.joint_count + 1)
        if f"theta_off_{j}" in free and f"theta_off_{j}" not in found
    )


def _drift(solution: Solution, recorded: Mapping[str, object]) -> float | None:
    found = recorded.get("parameters")
    estimate = solution.estimate
    if not isinstance(found, Mapping) or recorded.get("estimator") != estimate.estimator:
        return None
    if set(found) != {p.name for p in estimate.parameters}:
        return None
    changes = [
        math.remainder(float(value) - float(found[p.name]), 2.0 * math.pi)
        if p.is_angle
        else float(value) - float(found[p.name])
        for p, value in zip(estimate.parameters, estimate.x, strict=True)
    ]
    return max(abs(change) for change in changes)


def _simulated(events: Sequence[Event]) -> bool:
    """Judge by what the drives called themselves on the bus, whatever bus it was."""
    return any(
        "virtual" in str(node.get("device_name", ""))
        for event in events
        if event.name == "connected"
        for node in event.data.get("nodes", ())
    )
