"""Prior of a loop's unknowns in a new placement, and test of one more pose (innovation).

Earlier poses determine the arm's own entries. Offsets that are measured from the fixture change within the fixture's
tolerance at each remounting. If the fixture was once mounted outside its tolerance, the prior is wider accordingly.

The innovation is the deviation of a reading from its prediction by earlier poses of the same placement. Linearity
deviation, sag and compliance are nearly the same in poses nearby. So they do not make this prediction uncertain, but
they would make a prediction from the parameters alone uncertain.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from fixtures.base import ROUGH_PLACEMENT, EndpointConstraint
from fixtures.errors import FixtureError
from operator_app.calibration.error_model import error_model, free_within_tolerance
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.prediction import concatenated_poses, fit_as_stated
from operator_app.calibration.verification import stated_noise
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector
from solver.chain.poses import PoseSet
from solver.diagnostics.cross_validation import predicted_residuals, verify
from solver.diagnostics.limits import POSE_CHI2_RATIO_UNPREDICTED, POSE_CHI2_UNPREDICTED
from solver.errors import PosesDoNotFitError, SolverError
from solver.estimators.implicit import ImplicitFit, ParameterPrior, fit_implicit
from solver.estimators.paper import estimate_paper
from solver.loops.closure import ClosureModel, in_order

WITHIN = 3.0
"""Number of standard deviations in a tolerance."""

EXACT = 1e-6
"""Standard deviation (m, rad) of entries stated as exact: a prior needs a width."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownArm:
    """Information about the arm from poses in earlier placements of a fixture.

    `names`: the k entries that are the same in every placement. `values` (k,) and `covariance` (k, k): rad and m.
    `ends`: offsets (rad, by name) that are measured from the fixture, averaged over the earlier placements.
    `placement_ratio`: rms deviation of earlier placements from nominal, in standard deviations according to the
    fixture's tolerance; at least 1.
    """

    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    ends: Mapping[str, float]
    placements: int
    placement_ratio: float


def placement_prior(
    model: ClosureModel,
    arm: ArmModel,
    fixture: EndpointConstraint,
    stated: Mapping[str, float],
    known: KnownArm | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return mean (P,) and covariance (P, P), rad and m, of the prior of one placement's unknowns.

    `model` and `stated` are the results of `free_within_tolerance`.
    """
    mean, sd = nominal_vector(model.parameters), _by_files(model, arm, fixture, stated)
    if known is None:
        return mean, np.diag(sd**2)
    names = [p.name for p in model.parameters]
    sides = {*model.ground_side, *model.hand_side} - set(known.names)
    turned = known.placement_ratio * fixture.tolerance.orientation_rad / WITHIN
    for k, name in enumerate(names):
        if name in known.ends:
            # The mean of earlier placements and the present one deviate independently, with the same tolerance.
            mean[k], sd[k] = known.ends[name], turned * np.sqrt(1.0 + 1.0 / known.placements)
        elif name in sides:
            sd[k] *= known.placement_ratio
    covariance = np.diag(sd**2)
    columns = [names.index(name) for name in known.names]
    mean[columns] = known.values
    covariance[np.ix_(columns, columns)] = known.covariance
    return mean, covariance


def stated_fit(experiment: Experiment) -> tuple[ClosureModel, ParameterPrior, ImplicitFit] | None:
    """Fit poses with the errors that the files state; None if the poses cannot be fitted.

    Returns the loop with all entries free within tolerances, the prior of its unknowns from the files, and the fit.
    """
    arm, q = experiment.arm, experiment.poses.q_rad
    try:
        loop = experiment.loop()
        model, stated = free_within_tolerance(loop, arm)
        sd = np.maximum(_by_files(model, arm, experiment.fixture, stated), EXACT)
        # The paper's estimator needs all readings; those of unsensed joints are good enough for a start.
        sensed = loop.with_all_joints_sensed()
        x0 = in_order(model, sensed, estimate_paper(sensed, q).x)
        prior = ParameterPrior(mean=nominal_vector(model.parameters), precision=sd**-2)
        fitted = fit_implicit(model, q, stated_noise(experiment), x0, prior=prior)
    except (SolverError, FixtureError, np.linalg.LinAlgError):
        return None
    valid = fitted.converged and np.isfinite(fitted.covariance).all()
    return (model, prior, fitted) if valid else None


def known_arm(experiment: Experiment) -> KnownArm | None:
    """Return the information from poses of earlier placements; None if these poses cannot be fitted."""
    if (by := stated_fit(experiment)) is None:
        return None
    model, prior, fitted = by
    own = {*model.ground_side, *(() if experiment.fixture.stays_on_hand else model.hand_side)}
    shared, placed_columns, ends = list[int](), list[int](), dict[str, list[float]]()
    for k, p in enumerate(model.parameters):
        if p.name not in own:
            shared.append(k)
        elif p.name.startswith("theta_off_"):
            ends.setdefault(p.name.partition("[")[0], []).append(float(fitted.x[k]))
        else:
            placed_columns.append(k)
    pulls = (fitted.x - prior.mean)[placed_columns] * np.sqrt(prior.precision[placed_columns])
    # Poses that fit worse than stated carry less information: their covariance is scaled up.
    worse = max(1.0, fitted.chi2 / fitted.dof)
    return KnownArm(
        names=tuple(model.parameters[k].name for k in shared),
        values=fitted.x[shared],
        covariance=worse * fitted.covariance[np.ix_(shared, shared)],
        ends={name: float(np.mean(values)) for name, values in ends.items()},
        placements=len(experiment.poses.placements),
        placement_ratio=max(1.0, float(np.sqrt(np.mean(pulls**2)))) if placed_columns else 1.0,
    )


def _by_files(
    model: ClosureModel, arm: ArmModel, fixture: EndpointConstraint, stated: Mapping[str, float]
) -> FloatArray:
    """Return the standard deviation (P,) of each unknown, from the files of arm and fixture.

    Offsets have at least a protractor's uncertainty, even if the file states less: the arm may not be calibrated yet.
    """
    offset = max(ROUGH_PLACEMENT.orientation_rad / WITHIN, arm.offset_tolerance_rad or 0.0)
    tolerance = fixture.tolerance
    sides, sd = {*model.ground_side, *model.hand_side}, []
    for p in model.parameters:
        placed = (tolerance.orientation_rad if p.is_angle else tolerance.position_m) / WITHIN
        if p.name.startswith("theta_off_"):
            sd.append(max(offset, placed if p.name in sides else 0.0))
        elif p.name in sides:
            sd.append(max(placed, stated.get(p.name, 0.0)))
        else:
            sd.append(stated.get(p.name, placed))
    return np.array(sd)


NEAREST = 60
"""Largest number of poses, those nearest to a reading, that predict the reading; it limits the computing time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftOfReading:
    """Shift of one joint's reading at one pose: its most likely size and sigma (rad), and how much chi2 it explains."""

    size_rad: float
    sigma_rad: float
    explains: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Innovation:
    """Deviation of a reading from the prediction by earlier poses.

    `chi2`: chi2 of the reading; infinite if the loop does not close at the reading. `dof`: its degrees of freedom.
    `usual`: largest chi2 of any earlier pose, predicted from the other earlier poses. Wrong files increase it too.
    `shifts`: by joint (1-based), the shift of this joint's reading that would explain most of the deviation.
    """

    chi2: float
    dof: int
    usual: float
    shifts: Mapping[int, ShiftOfReading]

    def unseen(self, shift_rad: float, chi2: float) -> tuple[int, ...]:
        """Return the joints (1-based) for which a shift `shift_rad` is expected to raise chi2 by less than `chi2`."""
        return tuple(j for j, s in self.shifts.items() if (shift_rad / s.sigma_rad) ** 2 < chi2)


def innovation(experiment: Experiment, reading: PoseSet) -> Innovation | None:
    """Test a reading against earlier poses (`experiment`) of one placement; None if these poses cannot be fitted."""
    away = np.abs(experiment.poses.q_rad - reading.q_rad[0]).max(axis=1)
    experiment = experiment.at_poses(np.sort(np.argsort(away, kind="stable")[:NEAREST]))
    if (by := stated_fit(experiment)) is None:
        return None
    model, _, fit = by
    before, count = experiment.poses, len(experiment.poses)
    both = replace(experiment, poses=concatenated_poses(before, reading))
    tolerance = free_within_tolerance(experiment.loop(), experiment.arm)[1]
    errors = error_model(both, tolerance=tolerance)
    try:
        fitted = fit_as_stated(model, both.poses, errors, fit.x, old=count)
        # Fitted without the tested reading: a wrong reading would change the linearisation.
        old = np.arange(count)
        own = fit_as_stated(model, before, errors.at_poses(old), fit.x, old=count).fit
        residuals = predicted_residuals(fitted.fit, np.arange(count + 1) == count)
        usual = [predicted_residuals(own, old == k).chi2 for k in range(count)]
    except (PosesDoNotFitError, np.linalg.LinAlgError):
        return None
    system = fitted.fit.whole.at_poses(np.array([count]))
    shifts = {}
    for j in range(1, experiment.arm.joint_count + 1):
        if j not in model.unsensed_joints:
            (s,), ((information,),) = residuals.score(system.B[..., [j - 1]])
            size, sigma = float(s / information), float(information**-0.5)
            shifts[j] = ShiftOfReading(size_rad=size, sigma_rad=sigma, explains=(size / sigma) ** 2)
    return Innovation(chi2=residuals.chi2, dof=residuals.dof, usual=max(usual), shifts=shifts)


LEAST, AT_MOST = 10, 60
"""Smallest number of earlier poses that `is_unpredicted` needs, and largest number (the latest) that it uses."""


def is_unpredicted(experiment: Experiment) -> bool:
    """Whether the last pose contradicts the prediction from earlier poses; false if no prediction is possible."""
    count = len(experiment.poses)
    if count <= LEAST or not experiment.fixture.holds_hand:
        return False
    by = stated_fit(experiment.at_poses(np.arange(max(0, count - 1 - AT_MOST), count - 1)))
    if by is None:
        return False
    model, _, fit = by
    last = experiment.at_poses(np.array([count - 1]))
    one_pose, noise = model.at_poses(np.array([0])), stated_noise(last)
    verified = verify(one_pose, fit.x, fit.covariance, last.poses.q_rad, noise)
    usual = POSE_CHI2_RATIO_UNPREDICTED * float(fit.pose_chi2.max())
    return float(verified.pose_chi2[0]) > max(POSE_CHI2_UNPREDICTED, usual)
