"""Independent check (paper, section 4) of a calibration with measured endpoints of the open arm.

A second calibration is made from the measured endpoints alone, and the two calibrations are compared. Both use the
maker's lengths, so that their errors are correlated and the test is conservative.
"""

from dataclasses import dataclass, replace

import numpy as np

from fixtures.measured import Measured
from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.comparison import ParameterChange, significant_changes
from operator_app.calibration.instrument_registration import placed_by_poses
from operator_app.calibration.result import Solution
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import wrap_angles
from solver.chain.poses import PoseSet
from solver.diagnostics.limits import DRIFT_FALSE_ALARM_PROBABILITY
from solver.diagnostics.statistics import Chi2Test, chi2_test, sigmas_at


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenLoopCheck:
    """Check of a closed-loop calibration on the open arm.

    `solution`: calibration of the open arm.
    `differences`: change of each parameter of the arm that both calibrations identified, from its value in the closed
    loop (`before`) to that in the open arm (`after`). `chi2`: chi2 of all differences together.
    `left_out`: offsets not compared, because the open arm does not determine them or they depend on the fixture.
    """

    solution: Solution
    differences: tuple[ParameterChange, ...]
    chi2: Chi2Test
    left_out: tuple[str, ...]

    @property
    def disagree(self) -> tuple[ParameterChange, ...]:
        """Significant differences of parameters, the worst first."""
        return significant_changes(self.differences)

    @property
    def holds(self) -> bool:
        """Whether the open-arm calibration is accepted and agrees with the closed-loop calibration."""
        return self.solution.accepted and not self.disagree and self.chi2.per_dof <= self.chi2.high


def check_open_loop(
    arm: ArmModel, instrument: Measured, poses: PoseSet, closed: Solution
) -> OpenLoopCheck:
    """Check a closed-loop calibration with measured endpoints of the open arm.

    Raises `EndpointMissingError` if the poses have no endpoints, `SolverError` if these do not suffice to calibrate.
    """
    own = {*closed.model.ground_side, *closed.model.hand_side}
    values = {n: v for n, v in closed.estimate.values_by_name.items() if n not in own}
    unknown = replace(instrument, full_pose=True, base_known=False, tip_known=False)
    placed = placed_by_poses(arm, unknown, poses, values)
    opened = calibrate(arm, placed, poses, drop=True)
    estimate = opened.estimate
    names, known = ([p.name for p in e.parameters] for e in (estimate, closed.estimate))
    shared = [name for name in known if name in names and name not in own]
    a, b = ([listed.index(name) for name in shared] for listed in (known, names))
    parameters = [estimate.parameters[k] for k in b]
    change = wrap_angles(parameters, estimate.x[b] - closed.estimate.x[a])
    covariance = closed.estimate.covariance[np.ix_(a, a)] + estimate.covariance[np.ix_(b, b)]
    sigma = np.sqrt(np.diagonal(covariance))
    threshold = sigmas_at(DRIFT_FALSE_ALARM_PROBABILITY, len(shared))
    scaled = covariance / np.outer(sigma, sigma)
    z = change / sigma
    return OpenLoopCheck(
        solution=opened,
        differences=tuple(
            ParameterChange(
                name=p.name,
                is_angle=p.is_angle,
                before=float(closed.estimate.x[i]),
                after=float(estimate.x[j]),
                change=float(c),
                sigma=float(s),
                significant=bool(abs(c) > threshold * s),
            )
            for p, i, j, c, s in zip(parameters, a, b, change, sigma, strict=True)
        ),
        chi2=chi2_test(float(z @ np.linalg.pinv(scaled) @ z), len(shared)),
        left_out=tuple(n for n in known if n not in shared and n.startswith("theta")),
    )
