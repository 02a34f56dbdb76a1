"""`calibrate` calibrates an arm from poses in a fixture; `load_result` reads the result of a session."""

from __future__ import annotations

from os import PathLike, fspath
from pathlib import Path
from typing import Any, Literal, get_args

from operator_app.calibration.calibrate import calibrate as solve
from operator_app.calibration.cross_validation import check
from operator_app.messages.finding import Finding, FindingKind
from operator_app.session.store.stored_calibration import session_calibration
from operator_app.session.workflow.importing import CalibrationOptions
from operator_app.session.workflow.opening import Choices, resume

from .calls import WholeNumbers, joints, one_blas_thread, one_of, shown, tolerance_m
from .machines import Arm, Fixture, load_arm, load_fixture
from .poses import Poses, load_poses
from .result import Journalled, Result

Estimator = Literal["implicit", "paper"]


@one_blas_thread
def calibrate(
    *,
    arm: str | PathLike[str] | Arm,
    fixture: str | PathLike[str] | Fixture,
    poses: str | PathLike[str] | Poses | Any,
    estimator: Estimator = "implicit",
    unsensed_joints: WholeNumbers = (),
    global_start: bool = False,
    drop_unidentifiable: bool = False,
    length_tolerance_mm: float | None = None,
    checks: bool = False,
) -> Result:
    """Calibrate an arm from measured poses of the closed chain, as ``sarcal solve`` does.

    Parameters
    ----------
    arm, fixture
        As for `load_arm` and `load_fixture`: a path, a built-in name, or an object that they returned.
    poses
        As for `load_poses`: a path, a data frame, `Poses`, or a `Simulation`.
    estimator
        ``implicit`` weights every joint by its sensor and includes all errors that the files state; ``paper`` is the
        published unweighted least squares.
    unsensed_joints
        Joints (from 1) whose readings are not used.
    global_start
        Search without a first guess instead of starting from the nominal values.
    drop_unidentifiable
        Fix undetermined parameters at their nominal values, instead of raising UnidentifiableError.
    length_tolerance_mm
        Standard deviation of the lengths in the arm file; None: as the arm file states.
    checks
        Also compute the cross-validation: jackknife and hold-out.

    Returns
    -------
    Result
        A calibration that is not accepted is returned too; see `Result.accepted` and `Result.reasons`.

    Raises
    ------
    TypeError, ValueError
        An argument is invalid; the text names it.
    ConfigError
        A file is invalid; the text lists all problems.
    UnidentifiableError, SolverError, FixtureError
        The poses do not suffice; the text says what is missing.

    Examples
    --------
    >>> import sarcal
    >>> made = sarcal.simulate(arm="sarcos_dextrous", fixture="hinge", poses=30, seed=1)
    >>> result = sarcal.calibrate(
    ...     arm="sarcos_dextrous", fixture="hinge", poses=made.poses, estimator="paper"
    ... )
    >>> len(result.values)
    14
    """
    one_of("estimator", estimator, get_args(Estimator))
    loaded_arm, loaded_fixture = load_arm(arm), load_fixture(fixture)
    loaded_poses = load_poses(poses, joint_count=loaded_arm.joint_count)
    options = CalibrationOptions(
        estimator=estimator,
        unsensed_joints=joints("unsensed_joints", unsensed_joints, loaded_arm.joint_count),
        length_tolerance_m=tolerance_m("length_tolerance_mm", length_tolerance_mm),
        drop_unidentifiable=drop_unidentifiable,
    )
    model, constraint = loaded_arm._model, loaded_fixture._spec.fixture
    solution = solve(
        model,
        constraint,
        loaded_poses._set,
        estimator=options.estimator,
        unsensed_joints=options.unsensed_joints,
        search=global_start,
        drop=options.drop_unidentifiable,
        length_tolerance_m=options.length_tolerance_m,
    )
    solution = solution.with_notices(
        Finding(FindingKind.REPORTED, names=(w.code,), reported=(w.text,))
        for w in loaded_poses._warnings
    )
    return Result(
        arm=loaded_arm,
        fixture=loaded_fixture,
        poses=loaded_poses,
        solution=solution,
        checks=check(solution, model, constraint, loaded_poses._set) if checks else None,
        origin=options,
    )


SESSIONS = Path("sessions")
"""Folder in which a session that is given by name is sought."""


@one_blas_thread
def load_result(session: str | PathLike[str]) -> Result:
    """Return the calibration of a session made by ``sarcal run``, ``sarcal import`` or `Result.save`.

    The poses are not solved again, unless an earlier version made the session and its solution is missing or
    outdated.

    Parameters
    ----------
    session
        Folder of the session, or its name in the folder ``sessions``, or ``latest``.

    Raises
    ------
    TypeError
        The argument is not a path.
    SessionError
        There is no such session, it cannot be read, or none of its poses is used.
    SolverError, FixtureError
        The session had to be solved again, and its poses do not suffice.

    Examples
    --------
    >>> import tempfile
    >>> import sarcal
    >>> made = sarcal.simulate(arm="sarcos_dextrous", fixture="hinge", poses=30, seed=0)
    >>> result = sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=made.poses)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     again = sarcal.load_result(result.save(folder))
    >>> again.values == result.values
    True
    >>> sarcal.compare(result, again).drifted
    ()
    """
    if not isinstance(session, str | PathLike):
        raise TypeError(f"session={shown(session)}: give the folder of a session, or its name")
    opening = resume(fspath(session), Choices(), root=SESSIONS)
    state, procedure = opening.state, opening.effective_procedure
    calibration = session_calibration(state, procedure)
    _, arm, fixture, _ = procedure.sources
    return Result(
        arm=Arm(procedure.arm.name, arm.file, procedure.arm, arm),
        fixture=Fixture(
            procedure.fixture.name, procedure.fixture.kind, fixture.file, procedure.fixture, fixture
        ),
        poses=Poses(str(opening.folder), state.pose_set()),
        solution=calibration.solution,
        checks=calibration.checks,
        origin=Journalled(folder=opening.folder, state=state, procedure=procedure),
    )
