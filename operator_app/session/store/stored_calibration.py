"""The calibration of a session as its journal has it: read back, never solved again without need.

Journals of earlier versions hold no solution, and a reader may ask for other options than the session
was solved with: only then the poses are solved, and `Calibrated.solved_again` says why. Knows no arm
and no renderer.
"""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.cross_validation import Checks, check
from operator_app.calibration.result import Solution
from operator_app.calibration.serialization import RecordError, from_dict, to_dict
from operator_app.errors import SessionError
from operator_app.messages.finding import Finding, FindingKind

if TYPE_CHECKING:
    from operator_app.config.procedure import Procedure
    from operator_app.session.store.state import SessionState
    from solver.estimators.estimate import Estimate


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredCalibration:
    """A session's calibration.

    Attributes
    ----------
    checks
        Second opinions; None where the journal has none for this solution.
    solved_again
        Why it was not read from the journal; empty when it was.
    """

    solution: Solution
    checks: Checks | None
    solved_again: str


def calibrated(
    state: SessionState,
    procedure: Procedure,
    *,
    estimator: str | None = None,
    unsensed_joints: tuple[int, ...] | None = None,
) -> StoredCalibration:
    """Return the calibration of the poses that count.

    Parameters
    ----------
    procedure
        The one the session follows, with the arm that was really there.
    estimator, unsensed_joints
        None: as the session was solved, or as the procedure says where it was not.

    Raises
    ------
    SessionError, SolverError, FixtureError
        There is no pose, or what the poses cannot give has to be solved after all.
    """
    if not state.used_poses:
        raise SessionError("this session has no pose that counts", "capture poses first")
    read = recorded(state)
    if isinstance(read, StoredCalibration):
        then = read.solution.estimate.estimator, read.solution.model.unsensed_joints
        asked = (
            then[0] if estimator is None else estimator,
            then[1] if unsensed_joints is None else _blind(procedure, unsensed_joints),
        )
        if asked == then:
            return read
        why = f"the session was solved by {then[0]}, joints {list(then[1])} unsensed"
    else:
        why = read
    before = _as_solved(state, procedure)
    solution = solve(
        state,
        procedure,
        estimator=estimator or before.estimator,
        unsensed_joints=before.unsensed_joints if unsensed_joints is None else unsensed_joints,
    )
    return StoredCalibration(solution=solution, checks=None, solved_again=why)


def solve(
    state: SessionState,
    procedure: Procedure,
    *,
    estimator: str,
    unsensed_joints: tuple[int, ...],
) -> Solution:
    """Calibrate from the poses that count, with the limits and tolerances of the procedure."""
    if unsensed_joints and estimator == "paper":
        raise SessionError(
            "the paper's estimator eliminates the hinge angle only (eqs. 10-13)",
            "use --estimator implicit with --unsensed",
        )
    solution = calibrate(
        procedure.arm,
        procedure.fixture.fixture,
        state.pose_set(),
        estimator=estimator,
        unsensed_joints=unsensed_joints,
        drop=bool(state.settings.get("drop_unidentifiable")),
        length_tolerance_m=procedure.length_tolerance_m,
        limits=procedure.acceptance,
        rereads=state.rereads,
    )
    return solution.with_notices(unreturned_notices(state))


def checked(
    found: StoredCalibration, state: SessionState, procedure: Procedure
) -> StoredCalibration:
    """Return a calibration that was solved again with second opinions on it; the journal's as it is."""
    if not found.solved_again:
        return found
    fixture = procedure.fixture.fixture
    return replace(found, checks=check(found.solution, procedure.arm, fixture, state.pose_set()))


def solved_data(
    solution: Solution, state: SessionState, *, length_tolerance_m: float | None
) -> dict[str, Any]:
    """Return what the journal keeps of a solution of the poses that count."""
    estimate = solution.estimate
    return {
        "estimator": estimate.estimator,
        "unsensed_joints": list(solution.model.unsensed_joints),
        "length_tolerance_m": length_tolerance_m,
        "poses": [p.number for p in state.used_poses],
        "rereads": len(state.rereads),
        "parameters": {
            p.name: float(v) for p, v in zip(estimate.parameters, estimate.x, strict=True)
        },
        "scaled_condition_number": solution.seen.scaled_condition_number,
        "accepted": solution.accepted,
        "made_with": versions(),
        "record": to_dict(solution),
    }


def recorded(state: SessionState) -> StoredCalibration | str:
    """Return what the journal has of the poses that count, or why it has nothing."""
    if not state.solution:
        return "its journal holds poses and no solution of them"
    try:
        solution = from_dict(Solution, state.solution)
        checks = from_dict(Checks, state.checks) if state.checks else None
    except RecordError:
        return "the solution in its journal is of another version of this program"
    used = [pose.number for pose in state.used_poses]
    if state.solved.get("poses", used) != used:
        return "the solution in its journal is of other poses"
    dropped = set(solution.dropped_flipped)
    estimates = (solution.estimate, solution.paper, solution.implicit)
    if not dropped <= set(range(len(used))) or not all(
        _holds_together(estimate, len(used) - len(dropped)) for estimate in estimates
    ):
        return "the figures of the solution in its journal do not go together"
    return StoredCalibration(solution=solution, checks=checks, solved_again="")


def _holds_together(estimate: Estimate | None, poses: int) -> bool:
    """Whether there is a value and a variance for each parameter, and a row for each of so many poses."""
    if estimate is None:
        return True
    count = len(estimate.parameters)
    of_poses = (estimate.residual, estimate.pose_chi2, estimate.corrections)
    return (
        estimate.x.shape == (count,)
        and estimate.covariance.shape == (count, count)
        and all(found is None or found.shape[:1] == (poses,) for found in of_poses)
        and estimate.dof > 0
    )


def _as_solved(state: SessionState, procedure: Procedure) -> Procedure:
    """Return the procedure with the options that the session was solved with, as far as it says."""
    solved: Mapping[str, object] = state.solved
    match solved.get("estimator"):
        case "paper" | "implicit" as estimator:
            procedure = replace(procedure, estimator=estimator)
    unsensed = solved.get("unsensed_joints")
    if isinstance(unsensed, list | tuple):
        procedure = replace(procedure, unsensed_joints=tuple(unsensed))
    return procedure


def _blind(procedure: Procedure, joints: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(sorted({*joints, *procedure.arm.unsensed_joints}))


NO_WAY_BACK = "no way back to it is planned from here"
"""Why a planned capture does not read its first pose once more: it would say so again at every resume."""


def unreturned_notices(state: SessionState) -> tuple[Finding, ...]:
    """Say for each placement whether its first pose was read once more after its last; nothing where it was."""
    if state.imported:
        # Nobody knows what was read again.
        return ()
    numbers = dict.fromkeys(p.placement for p in state.used_poses)
    return tuple(
        notice for k in numbers if (notice := _of_placement(state, k, several=len(numbers) > 1))
    )


def _of_placement(state: SessionState, placement: int, *, several: bool) -> Finding | None:
    here = [p.number for p in state.used_poses if p.placement == placement]
    again = [r for r in state.returns if r.first.placement == placement]
    if any(r.again.after >= here[-1] for r in again):
        return None
    why = "the capture ended before that"
    if placement == state.placement and state.return_missed:
        why = state.return_missed
    before = max((r.again.after for r in again), default=0)
    goes_on = placement == state.placement and why != NO_WAY_BACK
    return Finding(
        kind=FindingKind.NOT_REPEATED if goes_on else FindingKind.NEVER_REPEATED,
        joints=(placement,) if several else (),
        poses=(str(here[0]), str(before or here[0]), str(here[-1])),
        reported=(why,),
    )


def versions() -> dict[str, str]:
    """Return versions by name, as the journal keeps them."""
    libraries = {name: version(name) for name in ("sarcal", "numpy", "scipy")}
    return libraries | {"python": platform.python_version()}


def software_version() -> str:
    """Return them as one line: ``0.3.0 (numpy 2.3.5, scipy 1.16.3, python 3.11.2)``."""
    own, *others = versions().items()
    return f"{own[1]} ({', '.join(f'{name} {number}' for name, number in others)})"
