"""The calibration in the journal of a session.

The calibration is computed again only if the journal has no valid solution from the used poses, or the caller requests
other options; `StoredCalibration.recalculated_because` then states why.
"""

import math
import platform
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import Any, Literal

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.cross_validation import Checks, check
from operator_app.calibration.result import Solution
from operator_app.calibration.serialization import RecordError, from_dict, to_dict
from operator_app.config.procedure import Procedure
from operator_app.errors import SessionError
from operator_app.messages.finding import Finding, FindingKind
from operator_app.session.store.solver_process import Solver, solve_here
from operator_app.session.store.state import SessionState
from operator_app.units import joints_named
from solver.estimators.estimate import Estimate
from solver.estimators.least_squares import Progress


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredCalibration:
    """A session's calibration.

    `checks`: cross-validation; None if the journal has none for this solution.
    `recalculated_because`: why the solution in the journal was not used; empty if it was used.
    """

    solution: Solution
    checks: Checks | None
    recalculated_because: str


def session_calibration(
    state: SessionState,
    procedure: Procedure,
    *,
    estimator: Literal["paper", "implicit"] | None = None,
    unsensed_joints: tuple[int, ...] | None = None,
) -> StoredCalibration:
    """Return the calibration of the used poses.

    `procedure` must contain the arm that was connected. `estimator` and `unsensed_joints` are by default those of the
    journal's calibration or, if there is none, of the procedure. Raises SessionError, SolverError or FixtureError if
    there is no pose, or a new solution fails.
    """
    if not state.used_poses:
        raise SessionError("no pose of this session is in use", "capture poses first")
    read = journal_calibration(state)
    if isinstance(read, StoredCalibration):
        by, without = read.solution.estimate.estimator, read.solution.model.unsensed_joints
        unsensed = {*(unsensed_joints or ()), *procedure.arm.unsensed_joints}
        if (estimator or by) == by and (unsensed_joints is None or unsensed == {*without}):
            return read
        joints = (
            f"without the readings of {joints_named(without)}" if without else "with all readings"
        )
        reason = f"the session was solved by {by} {joints}"
    else:
        reason = read
    then = state.solved
    if unsensed_joints is None:
        unsensed_joints = tuple(then.get("unsensed_joints", procedure.unsensed_joints))
    estimator = estimator or then.get("estimator", procedure.estimator)
    options = replace(procedure, estimator=estimator, unsensed_joints=unsensed_joints)
    solution = solve(state, options)
    return StoredCalibration(solution=solution, checks=None, recalculated_because=reason)


def require_estimator_for(unsensed_joints: tuple[int, ...], estimator: str) -> None:
    """Raise SessionError if there are unsensed joints and `estimator` is ``paper``, which cannot estimate them."""
    if unsensed_joints and estimator == "paper":
        raise SessionError(
            "the paper's estimator eliminates the hinge angle only (eqs. 10-13)",
            "use --estimator implicit with --unsensed",
        )


def solve(
    state: SessionState,
    procedure: Procedure,
    *,
    solver: Solver = solve_here,
    progress: Progress | None = None,
) -> Solution:
    """Calibrate from the used poses with the procedure's options, limits and tolerances."""
    require_estimator_for(procedure.unsensed_joints, procedure.estimator)
    solution = solver(
        calibrate,
        procedure.arm,
        procedure.fixture.fixture,
        state.pose_set(),
        estimator=procedure.estimator,
        unsensed_joints=procedure.unsensed_joints,
        drop=bool(state.settings.get("drop_unidentifiable")),
        length_tolerance_m=procedure.length_tolerance_m,
        limits=procedure.acceptance,
        rereads=state.rereads,
        progress=progress,
    )
    return solution.with_notices(missing_repeat_notices(state))


def with_checks(
    calibration: StoredCalibration, state: SessionState, procedure: Procedure
) -> StoredCalibration:
    """Return the calibration. If it was not read from the journal, cross-validate it first."""
    if not calibration.recalculated_because:
        return calibration
    fixture = procedure.fixture.fixture
    return replace(
        calibration, checks=check(calibration.solution, procedure.arm, fixture, state.pose_set())
    )


def solution_data(solution: Solution, state: SessionState, procedure: Procedure) -> dict[str, Any]:
    """Return the data of a `solved` event; `procedure` must contain the `length_tolerance_m` used for `solution`."""
    estimate, condition = solution.estimate, solution.identifiability.scaled_condition_number
    return {
        "estimator": estimate.estimator,
        "unsensed_joints": list(solution.model.unsensed_joints),
        "length_tolerance_m": procedure.length_tolerance_m,
        "poses": [p.number for p in state.used_poses],
        "rereads": len(state.rereads),
        "parameters": estimate.values_by_name,
        # Infinite if the poses do not determine a parameter known from the files; JSON has no infinite numbers.
        **({"scaled_condition_number": condition} if math.isfinite(condition) else {}),
        "accepted": solution.accepted,
        "made_with": versions(),
        "record": to_dict(solution),
    }


def journal_calibration(state: SessionState) -> StoredCalibration | str:
    """Return the journal's calibration if it is valid and from the used poses; else why it is not usable."""
    if not state.solution:
        return "the journal contains poses but no calibration from them"
    try:
        solution = from_dict(Solution, state.solution)
        checks = from_dict(Checks, state.checks) if state.checks else None
    except RecordError:
        return "another version of this program wrote the solution in the journal"
    several = len(solution.model.parts()) > 1
    if solution.unsensed_offsets is None and (solution.model.unsensed_joints or several):
        return "an earlier version of this program, whose results differ, wrote the solution in the journal"
    used = [pose.number for pose in state.used_poses]
    if state.solved.get("poses", used) != used:
        return "the solution in the journal is from other poses"
    dropped = set(solution.dropped_flipped)
    estimates = filter(None, (solution.estimate, solution.paper, solution.implicit))
    if not dropped <= set(range(len(used))) or not all(
        _is_consistent(estimate, len(used) - len(dropped)) for estimate in estimates
    ):
        return "the solution in the journal is not consistent"
    return StoredCalibration(solution=solution, checks=checks, recalculated_because="")


def _is_consistent(estimate: Estimate, poses: int) -> bool:
    count = len(estimate.parameters)
    of_poses = (estimate.residual, estimate.pose_chi2, estimate.corrections)
    return (
        estimate.x.shape == (count,)
        and estimate.covariance.shape == (count, count)
        and all(array is None or array.shape[:1] == (poses,) for array in of_poses)
        and estimate.dof > 0
    )


NO_WAY_BACK = "no way back to it is planned from here"
"""Reason recorded if a planned capture has no path back to its first pose; resuming does not change that."""


def missing_repeat_notices(state: SessionState) -> tuple[Finding, ...]:
    """Return a finding for each placement in which no pose was measured again after the last used pose."""
    if state.imported:
        # A poses file does not mark repeats.
        return ()
    notices, placements = [], dict.fromkeys(p.placement for p in state.used_poses)
    for placement in placements:
        numbers = [p.number for p in state.used_poses if p.placement == placement]
        last = max(
            (r.again.after for r in state.repeats if r.first.placement == placement), default=0
        )
        if last >= numbers[-1]:
            continue
        current = placement == state.placement
        reason = (current and state.missed_repeat) or "the capture ended before that"
        goes_on = current and reason != NO_WAY_BACK
        notice = Finding(
            kind=FindingKind.NOT_REPEATED if goes_on else FindingKind.NEVER_REPEATED,
            joints=(placement,) if len(placements) > 1 else (),
            poses=(str(numbers[0]), str(last or numbers[0]), str(numbers[-1])),
            reported=(reason,),
        )
        notices.append(notice)
    return tuple(notices)


def versions() -> dict[str, str]:
    """Return the versions of this program and its numerical libraries by name, for the journal."""
    libraries = {name: version(name) for name in ("sarcal", "numpy", "scipy")}
    return libraries | {"python": platform.python_version()}


def software_version() -> str:
    """Return the versions in one line: ``0.3.0 (numpy 2.3.5, scipy 1.16.3, python 3.11.2)``."""
    own, *others = versions().items()
    return f"{own[1]} ({', '.join(f'{name} {number}' for name, number in others)})"
