"""From a pose set to a judged calibration: both estimators, what they can see, warnings, verdict.

The one place that decides what a calibration is worth; `sarcal solve`, the session and the terminal
app all call it. Knows no file, no bus and no screen.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from fixtures.base import Fixture, SetupCheck, Severity
from fixtures.errors import FixtureError
from solver.arm_model import ArmModel
from solver.arrays import BoolArray, FloatArray
from solver.closure import ClosureModel
from solver.errors import UnidentifiableError
from solver.estimate import Estimate, require_enough_poses
from solver.goodness import ClosureSigmas, closure_at_readings, closure_sigmas
from solver.identifiability import Identifiability, identifiability
from solver.implicit_estimator import NoiseModel, estimate_implicit
from solver.least_squares import Progress
from solver.paper_estimator import estimate_paper
from solver.parameters import nominal_vector
from solver.poses import PoseSet
from solver.sensors import Rvdt

ESTIMATORS = ("implicit", "paper")


class FixtureRefusedError(FixtureError):
    """A set-up check refuses this placement; `checks` say why and what to remount."""

    def __init__(self, checks: tuple[SetupCheck, ...]) -> None:
        self.checks = checks
        super().__init__("; ".join(f"{c.text}: {c.remedy}" for c in checks))


@dataclass(frozen=True, slots=True, kw_only=True)
class Notice:
    """Something the operator should know: a stable code and a sentence."""

    code: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class AcceptanceLimits:
    """What a calibration must reach to be accepted; None is no limit.

    The sigmas are the ``rms`` reading of eqs. 14 and 15.
    """

    scaled_condition_number: float = 100.0
    chi2_per_dof: float | None = None
    sigma_pos_m: float | None = None
    sigma_ori_rad: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """A judged calibration.

    Attributes
    ----------
    model
        The loop that was solved.
    estimate
        By the chosen estimator.
    paper
        By the paper's estimator on the same poses; None when joints are unsensed.
    seen
        Rank, condition number, weakest direction.
    before
        Closure sigmas at the nominal parameters, for comparison with `estimate.sigmas`.
    dropped_flipped
        Indices (into the poses given) left out because they lie on the flipped branch.
    reasons
        Why it is not accepted; empty when it is.
    """

    model: ClosureModel
    estimate: Estimate
    paper: Estimate | None
    seen: Identifiability
    before: ClosureSigmas
    poses: int
    dropped_flipped: tuple[int, ...]
    warnings: tuple[Notice, ...]
    reasons: tuple[str, ...]

    @property
    def accepted(self) -> bool:
        """Whether the calibration meets its limits."""
        return not self.reasons

    def with_notices(self, notices: Iterable[Notice]) -> Solution:
        """Return the same solution with more warnings."""
        return replace(self, warnings=(*self.warnings, *notices))


def calibrate(
    arm: ArmModel,
    fixture: Fixture,
    poses: PoseSet,
    *,
    estimator: str = "implicit",
    unsensed_joints: tuple[int, ...] = (),
    limits: AcceptanceLimits | None = None,
    progress: Progress | None = None,
) -> Solution:
    """Calibrate `arm` in `fixture` from measured poses.

    Raises
    ------
    TooFewPosesError, UnidentifiableError, FixtureRefusedError
        The data cannot give what is asked for; each says what is missing.
    """
    if estimator not in ESTIMATORS:
        raise ValueError(f"estimator must be one of {', '.join(ESTIMATORS)}")
    limits = AcceptanceLimits() if limits is None else limits
    unsensed_joints = tuple(sorted({*unsensed_joints, *arm.unsensed_joints}))
    model = fixture.model(arm, unsensed_joints=unsensed_joints)
    require_enough_poses(model, len(poses))
    nominal = nominal_vector(model.parameters)
    _refuse(fixture.placement_checks(arm, nominal, unsensed_joints=unsensed_joints))

    kept, flipped = _on_branch(model, poses.q_rad)
    q = poses.q_rad[kept]
    require_enough_poses(model, len(q))
    paper = None if unsensed_joints else estimate_paper(model, q)
    sigma = arm.sigma_rad()
    if paper is not None:
        # Before anything is weighted: an estimate along a blind direction is worth nothing.
        _require_identifiable(model, paper.x, q, sigma)
    if estimator == "paper":
        if paper is None:
            raise ValueError("the paper's estimator needs every joint sensed (eqs. 10-13)")
        estimate = paper
    else:
        noise = NoiseModel(joint_variance=sigma**2)
        x0 = None if paper is None else paper.x
        estimate = estimate_implicit(model, q, noise, x0=x0, progress=progress)
    seen = _require_identifiable(model, estimate.x, q, sigma)
    checks = fixture.placement_checks(arm, estimate.x, unsensed_joints=unsensed_joints)
    _refuse(checks)
    at_nominal = closure_at_readings(model, nominal, q)
    warnings = (
        *_setup_warnings(checks),
        *_flipped_warnings(flipped, poses.label),
        *_rvdt_warnings(arm, estimate, unsensed_joints),
    )
    return Solution(
        model=model,
        estimate=estimate,
        paper=paper,
        seen=seen,
        before=closure_sigmas(at_nominal.residual, at_nominal.rotation_rows),
        poses=len(q),
        dropped_flipped=flipped,
        warnings=warnings,
        reasons=_reasons(estimate, seen, limits),
    )


def _require_identifiable(
    model: ClosureModel, x: FloatArray, q: FloatArray, sigma_rad: FloatArray
) -> Identifiability:
    seen = identifiability(model, x, q, sigma_rad=sigma_rad)
    if seen.directions:
        raise UnidentifiableError(seen.directions)
    return seen


def _refuse(checks: tuple[SetupCheck, ...]) -> None:
    refused = tuple(c for c in checks if c.severity is Severity.REFUSED)
    if refused:
        raise FixtureRefusedError(refused)


def _on_branch(model: ClosureModel, q: FloatArray) -> tuple[BoolArray, tuple[int, ...]]:
    """Poses on the main branch of the hinge, and the indices of those on the other."""
    everything = np.ones(len(q), dtype=np.bool_)
    if model.unsensed_joints:
        return everything, ()
    flipped = set(estimate_paper(model, q).flipped)
    if not flipped:
        return everything, ()
    # With poses of both branches mixed in, the first fit is not to be believed; the branch most
    # poses are on is fitted alone and every pose judged by that.
    keep = np.array([k not in flipped for k in range(len(q))])
    if 2 * keep.sum() < len(q):
        keep = ~keep
    require_enough_poses(model, int(keep.sum()))
    x = estimate_paper(model, q[keep]).x
    judged = model.reduced(x, q).flipped
    return ~judged, tuple(int(k) for k in np.flatnonzero(judged))


def _setup_warnings(checks: tuple[SetupCheck, ...]) -> tuple[Notice, ...]:
    return tuple(
        Notice(code=c.code, text=f"{c.text}: {c.remedy}")
        for c in checks
        if c.severity is Severity.WARNING
    )


def _flipped_warnings(flipped: tuple[int, ...], labels: tuple[str, ...]) -> tuple[Notice, ...]:
    if not flipped:
        return ()
    names = ", ".join(labels[k] for k in flipped)
    return (
        Notice(
            code="FLIPPED_BRANCH",
            text=f"pose{'s' if len(flipped) > 1 else ''} {names} close only with the hand upside "
            "down on the hinge and were left out: take them again or remove them",
        ),
    )


def _rvdt_warnings(
    arm: ArmModel, estimate: Estimate, unsensed_joints: tuple[int, ...]
) -> tuple[Notice, ...]:
    """Compare what the loops say of each RVDT joint with what its data sheet allows."""
    found = []
    for j, joint in enumerate(arm.joints, 1):
        if not isinstance(joint.sensor, Rvdt) or j in unsensed_joints:
            continue
        lsb_mrad = 1e3 * joint.sensor.resolution_rad
        text = (
            f"joint {j} is read by a {joint.sensor.bits}-bit RVDT "
            f"(1 LSB = {lsb_mrad:.2f} mrad; linearity {100 * joint.sensor.linearity:.0f} % of "
            f"full scale = {1e3 * joint.sensor.linearity_rad:.0f} mrad)"
        )
        if estimate.corrections is not None:
            rms = float(np.sqrt(np.mean(estimate.corrections[:, j - 1] ** 2)))
            text += (
                f"; the loops disagree with its readings by {1e3 * rms:.1f} mrad rms, "
                f"{rms / joint.sensor.sigma_rad:.1f} times its noise"
            )
            if rms > 3.0 * joint.sensor.sigma_rad:
                text += f": solve with --unsensed {j} and compare"
        found.append(Notice(code=f"RVDT_{j}", text=text))
    return tuple(found)


def _reasons(
    estimate: Estimate, seen: Identifiability, limits: AcceptanceLimits
) -> tuple[str, ...]:
    reasons = []
    if not estimate.converged:
        reasons.append(f"the iteration did not converge in {estimate.iterations} steps")
    if seen.scaled_condition_number > limits.scaled_condition_number:
        reasons.append(
            f"scaled condition number {seen.scaled_condition_number:.0f} is above "
            f"{limits.scaled_condition_number:.0f}: take poses that differ more; "
            f"the weakest direction is {', '.join(seen.weakest.parameters[:4])}"
        )
    for symbol, found, limit, unit in (
        ("sigma_pos", estimate.sigmas.position_m.rms, limits.sigma_pos_m, "mm"),
        (
            "sigma_ori",
            estimate.sigmas.orientation_rad.rms,
            limits.sigma_ori_rad,
            "mrad",
        ),
    ):
        if limit is not None and found > limit:
            reasons.append(f"{symbol} {1e3 * found:.2f} {unit} is above {1e3 * limit:.2f} {unit}")
    ratio = estimate.chi2_per_dof
    if limits.chi2_per_dof is not None and ratio is not None and ratio > limits.chi2_per_dof:
        reasons.append(
            f"chi2/dof {ratio:.2f} is above {limits.chi2_per_dof:.2f}: the sensors or the fixture "
            "are worse than stated"
        )
    return tuple(reasons)
