"""The linear mixed model behind the variance components: which columns each of them has.

At the solution of the implicit iteration the reduced system of all poses is linear in parameters,
sensor curves and noise. Knows the implicit estimator's system; no likelihood, no report.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector
from solver.chain.sensor_curve import SensorCurve, curves_of
from solver.estimators.implicit import ImplicitFit, NoiseModel, ParameterPrior
from solver.estimators.reml import MixedModel
from solver.loops.closure import ClosureModel

FLOOR = 1e-3
"""No reading is believed beyond this share of its stated standard deviation."""

FIRST_FLEXURE_RAD, FIRST_FLEXURE_M = 1e-3, 3e-4
"""Where the search for a flexure starts."""

FIRST_CURVE = 2e-3
"""Where the search for a curve's amplitude starts, as a fraction of full scale."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ComponentPlan:
    """Which variances to estimate.

    Attributes
    ----------
    noisy_joints
        Joints (1-based) whose noise is estimated: the RVDTs.
    curves
        Sensors whose smooth curve is a random effect with an amplitude to be estimated: it is the
        same in every pose and does not average out as noise does.
    flexure
        Whether the fixture may be found to give.
    tolerance
        Standard deviation (rad, m) of free parameters whose nominal values are known beforehand,
        by name: lengths from the maker's table.
    """

    noisy_joints: tuple[int, ...] = ()
    curves: tuple[SensorCurve, ...] = ()
    flexure: bool = True
    tolerance: Mapping[str, float] = field(default_factory=dict)


def plan_of(arm: ArmModel, *, unsensed_joints: tuple[int, ...] = ()) -> ComponentPlan:
    """Plan for an arm: noise and curve of every RVDT whose reading is used, and the flexure."""
    curves = curves_of(arm, unsensed_joints=unsensed_joints)
    return ComponentPlan(noisy_joints=tuple(c.joint for c in curves), curves=curves)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ComponentModel:
    """A closure model, its readings (m, n) in rad, their stated noise and a plan.

    Components are ordered: noise of each joint, fixture (rad, m), curve amplitudes, and last the
    tolerances as one effect of known variance 1.
    """

    model: ClosureModel
    q: FloatArray
    noise: NoiseModel
    plan: ComponentPlan

    def __post_init__(self) -> None:
        joints = (*self.plan.noisy_joints, *(c.joint for c in self.plan.curves))
        for joint in joints:
            if not 1 <= joint <= self.model.joint_count or joint in self.model.unsensed_joints:
                raise ValueError(f"joint {joint} has no reading in use whose noise could be found")
        names = [p.name for p in self.model.parameters]
        for name, sd in self.plan.tolerance.items():
            if name not in names:
                raise ValueError(f"{name} has a tolerance and is not a free parameter")
            if not sd > 0.0:
                raise ValueError(f"the tolerance of {name} must be positive")

    @property
    def soft(self) -> BoolArray:
        """Which parameters (P,) have a tolerance."""
        return np.array([p.name in self.plan.tolerance for p in self.model.parameters], dtype=bool)

    @property
    def soft_sd(self) -> FloatArray:
        """Tolerances of the soft parameters, in their order."""
        tolerance = self.plan.tolerance
        return np.array(
            [tolerance[p.name] for p in self.model.parameters if p.name in tolerance], dtype=float
        )

    @property
    def has_rotations(self) -> bool:
        """Whether the fixture holds the hand's orientation at all."""
        return self.model.equations_per_pose + self._eliminated > 3

    @property
    def _eliminated(self) -> int:
        return int(
            self.model.initial_unsensed(nominal_vector(self.model.parameters), self.q).shape[-1]
        )

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of all components in their order."""
        found = [f"rvdt_{j}" for j in self.plan.noisy_joints]
        if self.plan.flexure:
            found += ["fixture_rad"] if self.has_rotations else []
            found += ["fixture_m"]
        found += [f"curve_{c.joint}" for c in self.plan.curves]
        return (*found, *(["tolerance"] if self.soft.any() else []))

    @property
    def held(self) -> BoolArray:
        """Components whose variance is known."""
        return np.array([name == "tolerance" for name in self.labels], dtype=bool)

    @property
    def of_fixture(self) -> BoolArray:
        """Components of the fixture's flexure."""
        return np.array([name.startswith("fixture_") for name in self.labels], dtype=bool)

    def floor_variance(self) -> FloatArray:
        """Variances of all readings (m, n) that are taken for known, rad^2."""
        floor = np.array(np.broadcast_to(self.noise.joint_variance, self.q.shape))
        for joint in self.plan.noisy_joints:
            floor[:, joint - 1] *= FLOOR**2
        return floor

    def first_variances(self, *, flexure: bool) -> FloatArray:
        """Where to start the search."""
        stated = np.broadcast_to(self.noise.joint_variance, self.q.shape).mean(axis=0)
        half = {f"curve_{c.joint}": c.half_scale_rad for c in self.plan.curves}
        first = []
        for name in self.labels:
            if name.startswith("rvdt_"):
                first.append(stated[int(name.removeprefix("rvdt_")) - 1])
            elif name.startswith("curve_"):
                first.append((FIRST_CURVE * 2.0 * half[name]) ** 2)
            elif name == "tolerance":
                first.append(1.0)
            else:
                size = FIRST_FLEXURE_RAD if name == "fixture_rad" else FIRST_FLEXURE_M
                first.append(size**2 if flexure else 0.0)
        return np.array(first)

    def noise_at(self, variances: FloatArray) -> NoiseModel:
        """Noise model of the implicit iteration for the given variances."""
        found = dict(zip(self.labels, variances, strict=True))
        joint = self.floor_variance()
        for j in self.plan.noisy_joints:
            joint[:, j - 1] += found[f"rvdt_{j}"]
        give = np.zeros(6) if self.noise.fixture_variance is None else self.noise.fixture_variance
        give = give + np.repeat([found.get("fixture_rad", 0.0), found.get("fixture_m", 0.0)], 3)
        return NoiseModel(joint_variance=joint, fixture_variance=give)

    def prior(self) -> ParameterPrior | None:
        """Tolerances as the implicit iteration takes them."""
        if not self.soft.any():
            return None
        precision = np.zeros(len(self.soft))
        precision[self.soft] = 1.0 / self.soft_sd**2
        return ParameterPrior(mean=nominal_vector(self.model.parameters), precision=precision)

    def curve_basis(self, readings: FloatArray) -> tuple[FloatArray, ...]:
        """Shapes of every planned curve at joint angles (m, n): (m, c) each."""
        return tuple(c.basis(readings[:, c.joint - 1]) for c in self.plan.curves)

    def mixed(
        self, fit: ImplicitFit, basis: tuple[FloatArray, ...], curves: tuple[FloatArray, ...]
    ) -> MixedModel:
        """Linear mixed model at a fit whose readings were corrected by the given curves."""
        system = fit.system
        B, E, soft = system.B, system.E, self.soft
        Bt, Et = np.swapaxes(B, -1, -2), np.swapaxes(E, -1, -2)
        give = np.zeros(6) if self.noise.fixture_variance is None else self.noise.fixture_variance
        base = B @ (self.floor_variance()[..., :, None] * Bt)
        base = base + Et @ (give[-E.shape[-2] :, None] * E)
        noise = [b[..., :, None] * b[..., None, :] for b in self._columns(B)]
        if self.plan.flexure:
            rows = E.shape[-2] - 3
            if self.has_rotations:
                noise.append(Et[..., :rows] @ E[..., :rows, :])
            noise.append(Et[..., rows:] @ E[..., rows:, :])
        effects = [
            B[..., c.joint - 1, None] * shapes[..., None, :]
            for c, shapes in zip(self.plan.curves, basis, strict=True)
        ]
        # The misclosure as it would be with straight sensors and nominal lengths.
        w = system.w + sum((z @ b for z, b in zip(effects, curves, strict=True)), 0.0)
        if soft.any():
            t = (fit.x - nominal_vector(self.model.parameters))[soft]
            w = w - system.A[..., soft] @ t
            effects.append(-system.A[..., soft] * self.soft_sd)
        return MixedModel(
            w=w, A=system.A[..., ~soft], base=base, noise=tuple(noise), effects=tuple(effects)
        )

    def parameter_covariance(self, covariance: FloatArray) -> FloatArray:
        """Covariance (P, P) of all parameters from that of the mixed model's (-dx, b)."""
        soft = self.soft
        hard = int((~soft).sum())
        picked = np.concatenate(
            (np.arange(hard), np.arange(len(covariance) - len(self.soft_sd), len(covariance)))
        )
        sizes = np.concatenate((-np.ones(hard), self.soft_sd))
        block = covariance[np.ix_(picked, picked)] * np.outer(sizes, sizes)
        place = np.concatenate((np.flatnonzero(~soft), np.flatnonzero(soft)))
        out = np.empty_like(block)
        out[np.ix_(place, place)] = block
        return out

    def _columns(self, B: FloatArray) -> list[FloatArray]:
        return [B[..., j - 1] for j in self.plan.noisy_joints]
