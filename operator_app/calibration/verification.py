"""Verification of a calibration with new poses; all parameters are fixed before these poses are taken."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from fixtures.base import EndpointConstraint
from fixtures.measured import Measured
from operator_app.calibration.calibrated_arm import (
    ClosureInUse,
    closure_in_use,
    with_estimated_place,
)
from operator_app.calibration.error_model import (
    averaged_at_rest,
    distinct_poses,
    noise_model,
)
from operator_app.calibration.experiment import Experiment, with_angles_of_unsensed
from operator_app.calibration.instrument_registration import (
    endpoints_at_nominal_base,
    with_calibrated_places,
)
from operator_app.calibration.new_poses import (
    NoTestError,
    is_elsewhere,
    require_calibrated_placement,
    require_in_range,
    require_new,
    require_poses_at_a_place,
)
from operator_app.calibration.prediction import (
    as_calibrated,
    joint_loops,
    predict_new_poses,
    shift_in_words,
)
from operator_app.calibration.result import Solution
from solver.arrays import FloatArray, select_poses
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector
from solver.chain.poses import PoseSet
from solver.diagnostics import limits
from solver.diagnostics.cross_validation import (
    CommonShift,
    HeldOutPoses,
    shifted,
    verify,
)
from solver.diagnostics.hypothesis_tests import find_outliers, leave_one_out_chi2
from solver.diagnostics.statistics import Chi2Test, chi2_probability, chi2_test
from solver.diagnostics.whitened_residuals import WhitenedResiduals
from solver.estimators.error_model import SD_OF_PEAK
from solver.estimators.estimate import Estimate, closure_at_readings
from solver.estimators.implicit import NoiseModel
from solver.estimators.variance_components import VarianceComponents
from solver.loops.closure import ClosureSigmas


class Fixed(NamedTuple):
    """Estimate of a calibration that is to be tested with new poses.

    `unsensed_joints`: joints whose readings the calibration did not use. `components`: errors that it estimated.
    """

    estimate: Estimate
    unsensed_joints: tuple[int, ...]
    components: VarianceComponents | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class VerificationResult:
    """Result of a verification with new poses.

    `nominal`: closure sigmas of the same poses at the nominal parameters, for comparison.
    `odd_poses`: rows of the outliers, the worst first. An outlier deviates too much to be due to chance. If several
    rows repeat an outlier, only the first row is listed. Without any fault, 1 in 1000 pose sets has an outlier.
    `poses`: number of distinct poses.
    `stated`: chi2 test with at least the stated variances. Its upper limit includes a factor: `STATED_VARIANCE_FACTOR`,
    or the chi2/dof of the accepted calibration if that is larger.
    `shift`: common shift of one joint or the fixture in all new poses; None if there is none.
    `instrument`: whether an instrument measured the endpoints of the open arm, instead of a fixture.
    `others_fit`: whether the poses outside `odd_poses` pass the test `stated`, and there is no common shift.
    `in_use`: closure sigmas of the same poses with the best table and with the corrections.
    """

    verification: HeldOutPoses
    nominal: ClosureSigmas
    odd_poses: tuple[int, ...]
    poses: int
    stated: Chi2Test
    shift: CommonShift | None = None
    instrument: bool = False
    others_fit: bool = False
    in_use: ClosureInUse = field(default_factory=ClosureInUse)

    @property
    def why(self) -> str:
        """The common shift as text; empty if there is none."""
        if self.shift is None:
            return ""
        return shift_in_words(self.shift, instrument=self.instrument)

    @property
    def holds(self) -> bool:
        """Whether the calibration predicts these poses within its stated uncertainty."""
        tested = self.verification
        if self.shift is not None or self.odd_poses:
            return False
        # A smaller chi2 than expected is no failure: these poses fit better than stated.
        return bool(tested.closed.all()) and self.stated.per_dof <= self.stated.high

    @property
    def verdict(self) -> str:
        """Whether the calibration holds, as text, with the common shift if there is one."""
        if self.holds:
            return "as expected"
        return "worse than expected" + (f" ({self.why})" if self.why else "")


def predict(new: Experiment, fixed: Fixed) -> HeldOutPoses:
    """Predict new poses from fixed parameters and test them; linearity deviation, sag and compliance count as noise."""
    model, x, covariance = as_calibrated(new.loop(), fixed.estimate)
    return verify(model, x, covariance, new.poses.q_rad, stated_noise(new, fixed.components))


def verify_poses(
    arm: ArmModel,
    fixture: EndpointConstraint,
    poses: PoseSet,
    solution: Solution,
    made_from: PoseSet,
    *,
    elsewhere: bool = False,
) -> VerificationResult:
    """Test new poses of the same arm in the same fixture: in one calibrated placement, or in all of them.

    `made_from`: the calibration's poses, flipped ones included. They predict linearity deviation, sag and compliance.
    The test also looks for one shift common to all new poses. Rows that repeat a pose count once.
    `elsewhere`: the new poses may be in other placements, which they determine, with all other parameters fixed.
    Raises `ValueError` if the calibration has another fixture or another number of placements. Raises `NoTestError` if
    the new poses only suffice to locate their own socket or station.
    """
    rows = averaged_at_rest(arm, poses)
    distinct, which = distinct_poses(rows, np.ones(len(rows), dtype=np.bool_))
    new = rows.at_poses(distinct)
    if elsewhere:
        require_poses_at_a_place(new, made_from, fixture)
    result = _verify_distinct(arm, fixture, new, solution, made_from, elsewhere=elsewhere)
    of_rows = select_poses(result.verification, which, "pose_chi2", "pose_probability", "closed")
    odd = tuple(int(distinct[k]) for k in result.odd_poses)
    return replace(result, verification=of_rows, odd_poses=odd)


def _verify_distinct(
    arm: ArmModel,
    fixture: EndpointConstraint,
    poses: PoseSet,
    solution: Solution,
    made_from: PoseSet,
    *,
    elsewhere: bool,
) -> VerificationResult:
    """Test poses of which none repeats another; arguments and errors as for `verify_poses`."""
    fixture = with_calibrated_places(fixture, solution.model)
    poses, made_from = (with_angles_of_unsensed(arm, fixture, p) for p in (poses, made_from))
    calibrated = made_from.placements
    if len(poses.placements) == len(calibrated) == 1 and not elsewhere:
        # The new poses get the number of the only calibrated placement, whatever their file states.
        poses = replace(poses, placement=np.full(len(poses), calibrated[0]))
    if elsewhere and isinstance(fixture, Measured):
        others = tuple(k for k in poses.placements if k not in calibrated)
        poses = endpoints_at_nominal_base(arm, fixture, poses, solution, others)
    unsensed = solution.model.unsensed_joints
    new = Experiment(arm=arm, fixture=fixture, poses=poses, unsensed=unsensed)
    loops = joint_loops(new, solution, made_from, elsewhere=elsewhere)
    model, x, unknown = loops.model.at_poses(np.flatnonzero(loops.later)), loops.x, loops.unknown
    noise = stated_noise(new, solution.components)
    tested = verify(model, x, loops.covariance, poses.q_rad, noise)
    if unknown:
        # Estimating the fixture's place uses as many equations as it has unknowns.
        chi2 = tested.chi2
        dof = chi2.dof - len(unknown)
        tested = replace(tested, chi2=chi2_test(chi2.per_dof * chi2.dof, dof))
    nominal = with_estimated_place(model, nominal_vector(model.parameters), poses.q_rad, unknown)
    improbable = (
        tested.pose_probability < limits.FALSE_ALARM_PROBABILITY / len(poses)
    ) | ~tested.closed
    result = VerificationResult(
        verification=tested,
        nominal=closure_at_readings(model, nominal, poses.q_rad).sigmas,
        odd_poses=tuple(int(k) for k in np.argsort(tested.pose_probability) if improbable[k]),
        poses=len(poses),
        instrument=isinstance(fixture, Measured),
        stated=tested.chi2,
        in_use=closure_in_use(solution, arm, model, x, poses.q_rad, unknown),
    )
    if not tested.closed.all():
        return result
    if (predicted := predict_new_poses(loops, solution)) is None:
        return result
    own = solution.adjudication.stated_chi2_per_dof if solution.accepted else None
    return _with_prediction(result, *predicted, scale=max(1.0, own or 0.0))


def _with_prediction(
    result: VerificationResult,
    residuals: WhitenedResiduals,
    learned: Chi2Test,
    subjects: Mapping[str, FloatArray],
    *,
    scale: float,
) -> VerificationResult:
    """Return `result` with tests of the new poses against their prediction from the calibration's poses.

    `residuals`, `learned`, `subjects`: residuals, chi2 test and derivatives that `predict_new_poses` returns.
    `scale`: ratio (at least 1) of the accepted calibration's variances to the stated ones. Single poses are tested with
    this ratio, all poses together with the larger of this ratio and `STATED_VARIANCE_FACTOR`.
    """
    variance_factor = max(limits.STATED_VARIANCE_FACTOR, scale)
    stated = chi2_test(residuals.chi2, residuals.dof)
    outliers = find_outliers(residuals, scale=scale)
    stated = replace(stated, high=variance_factor * stated.high)
    # A shift counts only if it remains without the outliers.
    shift = shifted(outliers.rest, subjects, variance_factor=variance_factor)
    if shift is not None:
        residuals = residuals.with_columns(subjects[shift.subject])
        outliers = find_outliers(residuals, scale=scale)
    chi2, dof = leave_one_out_chi2(residuals.U, residuals.white)
    # If the only pose is an outlier, nothing is left to test.
    others = chi2_test(outliers.rest.chi2, outliers.rest.dof) if outliers.rest.dof > 0 else None
    return replace(
        result,
        verification=replace(
            result.verification,
            chi2=replace(
                learned,
                low=learned.low / limits.LEARNED_VARIANCE_FACTOR,
                high=learned.high * limits.LEARNED_VARIANCE_FACTOR,
            ),
            pose_chi2=chi2,
            pose_probability=chi2_probability(np.maximum(dof, 1), chi2 / scale),
        ),
        odd_poses=outliers.poses,
        shift=shift,
        stated=stated,
        others_fit=shift is None
        and others is not None
        and others.per_dof <= variance_factor * others.high,
    )


def stated_noise(
    experiment: Experiment, components: VarianceComponents | None = None
) -> NoiseModel:
    """Return the noise of new readings: as stated, or as estimated in a calibration (`components`) if smaller.

    A larger estimate is not used: a slip during the calibration may have caused it, and any later pose would then pass.
    """
    arm, compliance = experiment.arm, experiment.fixture.compliance
    stated = noise_model(experiment)
    # Noise and linearity deviation of an RVDT both affect a new reading.
    estimated: dict[int, float] = {}
    for c in () if components is None else components.components:
        kind, _, number = c.name.partition("_")
        if kind in ("rvdt", "curve"):
            estimated[int(number)] = estimated.get(int(number), 0.0) + c.sd**2
    variance = np.array(stated.joint_variance)
    variance += arm.backlash_rad**2 + arm.sag_rad**2 + 2.0 * arm.accuracy_rad**2
    for j, (linearity, gain) in enumerate(zip(arm.linearity_rad(), arm.gain_rad(), strict=True)):
        # At a new reading the linearity deviation is a further unknown error.
        total = variance[:, j] + (SD_OF_PEAK * linearity) ** 2
        least = np.maximum(variance[:, j], estimated.get(j + 1, np.inf))
        variance[:, j] = np.minimum(total, least) + gain**2
    deflection_variance = np.repeat([compliance.orientation_rad**2, compliance.position_m**2], 3)
    deflection_variance = deflection_variance + stated.deflection_variance
    if components is not None and components.noise.fixture_variance is not None:
        deflection_variance = np.minimum(deflection_variance, components.noise.fixture_variance)
    return NoiseModel(joint_variance=variance, fixture_variance=deflection_variance)


def verify_new_poses(
    arm: ArmModel,
    fixture: EndpointConstraint,
    solution: Solution,
    *,
    made_from: PoseSet,
    new: PoseSet,
) -> VerificationResult:
    """Test a calibration with poses that were not used to make it.

    `made_from`: the poses of `solution`. `new`: other poses, in one calibrated placement or in all of them; other
    placements are allowed where the function `may_be_elsewhere` is true. Raises `NoTestError` if no test is possible.
    """
    require_in_range(arm, new, solution)
    require_new(new, made_from, fixture)
    if new.endpoint is not None and fixture.kind != "measured":
        raise NoTestError(
            f"the new poses have measured endpoints, which a {fixture.kind} fixture does not use: "
            "use them with sarcal verify --open-loop, or leave them out"
        )
    require_calibrated_placement(new, made_from, fixture)
    elsewhere = is_elsewhere(new, made_from, fixture)
    return verify_poses(arm, fixture, new, solution, made_from, elsewhere=elsewhere)
