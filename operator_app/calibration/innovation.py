"""Innovation of a new reading: the deviation from its prediction by earlier poses, and shifts that would explain it.

Earlier poses have determined linearity deviation, sag and compliance near the reading, so that these errors add no
uncertainty to the prediction, in contrast to a prediction from the parameters alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from operator_app.calibration.error_model import error_model, free_within_tolerance
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.prediction import concatenated_poses, fit_as_stated
from operator_app.calibration.prior import stated_fit
from operator_app.calibration.verification import stated_noise
from solver.chain.poses import PoseSet
from solver.diagnostics.cross_validation import predicted_residuals, verify
from solver.diagnostics.limits import POSE_CHI2_RATIO_UNPREDICTED, POSE_CHI2_UNPREDICTED
from solver.errors import PosesDoNotFitError

NEAREST = 60
"""Number of nearest poses that predict a reading, so that the computing time is bounded."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftOfReading:
    """Most likely shift of a joint in one reading and its sigma, both in rad, and the chi2 that the shift explains."""

    size_rad: float
    sigma_rad: float
    explains: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Innovation:
    """Deviation of a reading from the prediction by earlier poses.

    `chi2`, `dof`: chi2 of the reading (infinite if the loop does not close there), and its degrees of freedom.
    `usual`: largest chi2 of an earlier pose as predicted from the others; also large if the files are wrong.
    `shifts`: shift of each used reading that would explain the deviation, by joint (1-based).
    """

    chi2: float
    dof: int
    usual: float
    shifts: Mapping[int, ShiftOfReading]

    def unseen(self, shift_rad: float, chi2: float) -> tuple[int, ...]:
        """Return the joints in which a shift of `shift_rad` would explain less than `chi2` on average."""
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
        # Fitted without the tested reading: a wrong one would change the linearisation.
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
"""Fewest earlier poses for a test, and number of latest poses to which the fit is limited, to bound its time."""


def is_unpredicted(experiment: Experiment) -> bool:
    """Whether the last pose contradicts its prediction from the poses before it; false if it cannot be predicted."""
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
