"""`calibrate` and `load_result` return a calibration; `verify` tests one with new poses, `compare` compares two."""

from dataclasses import dataclass, field, replace
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Literal, get_args

from operator_app.calibration.calibrate import calibrate as solve
from operator_app.calibration.comparison import CalibrationComparison
from operator_app.calibration.comparison import compare as compared
from operator_app.calibration.cross_validation import check
from operator_app.calibration.verification import VerificationResult, verify_new_poses
from operator_app.config.parameters_file import ParametersDocument
from operator_app.documents import parameters_at
from operator_app.messages.finding import Finding, FindingKind
from operator_app.report.results.comparison import comparison_json, comparison_text
from operator_app.report.results.verification import verification_json, verification_text
from operator_app.report.text import warning
from operator_app.session.store.stored_calibration import session_calibration
from operator_app.session.workflow.importing import CalibrationOptions
from operator_app.session.workflow.opening import Choices, resume
from solver.diagnostics.limits import DRIFT_FALSE_ALARM_PROBABILITY

from .calls import WholeNumbers, joints, number, one_blas_thread, one_of, shown, tolerance_m
from .machines import Arm, Fixture, load_arm, load_fixture
from .poses import Poses, load_poses
from .result import Result

Estimator = Literal["implicit", "paper"]
SESSIONS = Path("sessions")
"""Folder in which a session that is given by name is sought."""


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
        The poses do not suffice, or the placement of the fixture is refused; the text gives the reason.

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


@one_blas_thread
def load_result(session: str | PathLike[str]) -> Result:
    """Return the calibration of a session made by ``sarcal run``, ``sarcal import`` or `Result.save`.

    The poses are solved again only if an earlier version made the session, and its solution is missing or outdated.

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
        origin=replace(opening, procedure=procedure),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Verification:
    """Test of a calibration with new poses; made by `verify`. Its ``str`` is text for 80 columns."""

    _result: VerificationResult = field(repr=False)
    _poses: Poses = field(repr=False)
    _of: str = field(repr=False)

    @property
    def holds(self) -> bool:
        """Whether the calibration predicts the new poses within its stated uncertainty."""
        return self._result.holds

    @property
    def chi2_per_dof(self) -> float:
        """chi2/dof at the uncertainties in the files: about 1 if these are right, less than 1 if they are too large."""
        return self._result.verification.chi2.per_dof

    @property
    def odd_poses(self) -> tuple[str, ...]:
        """Names of the poses that deviate by more than chance allows, the largest deviation first."""
        return tuple(self._poses.names[k] for k in self._result.odd_poses)

    def to_json(self) -> dict[str, Any]:
        """Return the object of ``sarcal verify --json``."""
        return verification_json(self._result, self._poses._set)

    def __str__(self) -> str:
        text = verification_text(self._result, self._poses._set, self._of)
        return "\n".join([text, *(warning(w.text) for w in self._poses._warnings)])

    def __repr__(self) -> str:
        verdict = "holds" if self.holds else "does not hold"
        return f"<sarcal.Verification {verdict}: {len(self._poses)} new poses>"


@one_blas_thread
def verify(result: Result, poses: str | PathLike[str] | Poses | Any) -> Verification:
    """Test a calibration with new poses of the same arm in the same mounting.

    Parameters
    ----------
    result
        The calibration; it is not fitted again.
    poses
        As for `load_poses`; none of them may have been used in the calibration.

    Raises
    ------
    TypeError, ConfigError
        `result` is not a `Result`, or `poses` is invalid.
    ValueError
        Some poses were used in the calibration, are of another placement, have readings far outside the arm's ranges
        (e.g. in radians), or have measured endpoints although the fixture is not ``measured``.

    Examples
    --------
    >>> import sarcal
    >>> made = sarcal.simulate(arm="sarcos_dextrous", fixture="hinge", poses=40, seed=0)
    >>> q_rad = made.poses.q_rad
    >>> result = sarcal.calibrate(
    ...     arm="sarcos_dextrous", fixture="hinge", poses=sarcal.poses_of(q_rad=q_rad[:30])
    ... )
    >>> sarcal.verify(result, sarcal.poses_of(q_rad=q_rad[30:]))
    <sarcal.Verification holds: 10 new poses>
    """
    if not isinstance(result, Result):
        raise TypeError(
            f"result={shown(result)}: give what sarcal.calibrate or sarcal.load_result returned"
        )
    new = load_poses(poses, joint_count=result.arm.joint_count)
    tested = verify_new_poses(
        result.arm._model,
        result.fixture._spec.fixture,
        result._solution,
        made_from=result.poses._set,
        new=new._set,
    )
    return Verification(tested, new, f"{result.arm.name} in {result.fixture.name}")


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """Drift between two calibrations; made by `compare`. Its ``str`` is text for 80 columns."""

    _result: CalibrationComparison = field(repr=False)

    @property
    def drifted(self) -> tuple[str, ...]:
        """Names of the parameters that changed significantly, the most significant first."""
        return tuple(d.name for d in self._result.drifted)

    def to_json(self) -> dict[str, Any]:
        """Return the object of ``sarcal compare --json``."""
        return comparison_json(self._result)

    def __str__(self) -> str:
        return comparison_text(self._result)

    def __repr__(self) -> str:
        return f"<sarcal.Comparison: {len(self.drifted)} of {len(self._result.drifts)} drifted>"


@one_blas_thread
def compare(
    before: Result | str | PathLike[str],
    after: Result | str | PathLike[str],
    *,
    level: float = DRIFT_FALSE_ALARM_PROBABILITY,
    remounted: bool = False,
) -> Comparison:
    """Compare two calibrations of one arm, as ``sarcal compare`` does.

    Parameters
    ----------
    before, after
        Results, parameters files, or session folders.
    level
        Probability of a false alarm for all parameters together.
    remounted
        Whether the fixture was dismounted in between; if so, only the arm's own parameters are compared.

    Raises
    ------
    IncomparableError
        The two are not of the same arm, or have no parameter in common.
    ConfigError, SessionError
        A file or session does not exist, or has no calibration.
    TypeError, ValueError
        An argument is invalid; the text names it.

    Examples
    --------
    >>> import sarcal
    >>> made = sarcal.simulate(arm="sarcos_dextrous", fixture="hinge", poses=60, seed=0)
    >>> halves = [sarcal.poses_of(q_rad=made.poses.q_rad[k::2]) for k in (0, 1)]
    >>> a, b = (
    ...     sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=half) for half in halves
    ... )
    >>> sarcal.compare(a, b).drifted
    ()
    """
    if not 0.0 < number("level", level) < 1.0:
        raise ValueError(f"level={level}: give a probability between 0 and 1, such as 0.01")
    return Comparison(
        compared(
            _document("before", before),
            _document("after", after),
            level=float(level),
            remounted=remounted,
        )
    )


def _document(name: str, calibration: Result | str | PathLike[str]) -> ParametersDocument:
    if isinstance(calibration, Result):
        return calibration._document()
    if not isinstance(calibration, str | PathLike):
        raise TypeError(
            f"{name}={shown(calibration)}: give a Result, or the path of a parameters file or a "
            "session folder"
        )
    return parameters_at(fspath(calibration), SESSIONS)
