"""Prior of a loop's unknowns before the first pose of a placement, and the closure gate: a test without any pose.

The arm's own entries follow from earlier poses. Offsets that count from the fixture change within its tolerance when it
is remounted, and a fixture that was mounted farther from its nominal place may be so again.

The gate tests whether the loop can close at the present reading within the tolerances of the files. With S and Q the
covariances of the unknowns phi and of the readings q, the most probable way to close is

    min (phi - phi_0)' S^-1 (phi - phi_0) + (q - reading)' Q^-1 (q - reading),   c(phi, q, u) = 0,

by Newton's iteration on the reduced equations (`solver.closing`); its value is chi2 with as many degrees of
freedom as a pose has equations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fixtures.base import ROUGH_PLACEMENT, EndpointConstraint
from fixtures.errors import FixtureError
from operator_app.calibration.closed_loops import in_order, loop_of_poses
from operator_app.calibration.error_model import free_within_tolerance
from operator_app.calibration.verification import stated_noise
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector
from solver.chain.poses import PoseSet
from solver.chain.sensors import NoSensor
from solver.closing import reduced_equations, unsensed_step
from solver.errors import SolverError
from solver.estimators.implicit import ImplicitFit, ParameterPrior, fit_implicit
from solver.estimators.paper import estimate_paper
from solver.loops.closure import ClosureModel

WITHIN = 3.0
"""Number of standard deviations in a tolerance."""

EXACT = 1e-6
"""Standard deviation (m, rad) of entries stated as exact: a prior needs a width."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownArm:
    """Information about the arm from poses in earlier placements of a fixture.

    Attributes
    ----------
    names, values, covariance
        Entries that are the same in every placement: (k,), (k, k), rad and m.
    ends
        Offsets that count from the fixture, by name: their mean over the earlier placements.
    placements
        Number of earlier placements.
    placement_ratio
        Largest distance of the fixture from its nominal placement, as a multiple of its tolerance; at least 1.
    """

    names: tuple[str, ...]
    values: FloatArray
    covariance: FloatArray
    ends: Mapping[str, float]
    placements: int
    placement_ratio: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacementPrior:
    """Mean (P,) and covariance (P, P) of a loop's unknowns, rad and m."""

    mean: FloatArray
    covariance: FloatArray


def placement_prior(
    model: ClosureModel,
    arm: ArmModel,
    fixture: EndpointConstraint,
    stated: Mapping[str, float],
    known: KnownArm | None = None,
) -> PlacementPrior:
    """Return the prior of one placement's loop; `stated` and `model` are those of `free_within_tolerance`."""
    mean, sd = nominal_vector(model.parameters), _by_files(model, arm, fixture, stated)
    if known is None:
        return PlacementPrior(mean=mean, covariance=np.diag(sd**2))
    names = [p.name for p in model.parameters]
    sides = {*model.ground_side, *model.hand_side} - set(known.names)
    turned = known.placement_ratio * fixture.tolerance.orientation_rad / WITHIN
    for k, name in enumerate(names):
        if name in known.ends:
            # Earlier and present placements have the same tolerance about the nominal one.
            mean[k], sd[k] = known.ends[name], turned * np.sqrt(1.0 + 1.0 / known.placements)
        elif name in sides:
            sd[k] *= known.placement_ratio
    covariance = np.diag(sd**2)
    here = [names.index(name) for name in known.names]
    mean[here] = known.values
    covariance[np.ix_(here, here)] = known.covariance
    return PlacementPrior(mean=mean, covariance=covariance)


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedFit:
    """Fit of poses with the stated errors, all entries free within tolerances.

    `model`: the loop, its lengths and twists free. `nominal`, `sd`: nominal values and standard deviations (P,) of the
    unknowns, from the files. `fit`: result of the fit.
    """

    model: ClosureModel
    nominal: FloatArray
    sd: FloatArray
    fit: ImplicitFit


def stated_fit(
    arm: ArmModel, fixture: EndpointConstraint, poses: PoseSet, unsensed: tuple[int, ...]
) -> StatedFit | None:
    """Fit poses with the stated errors of their files; None where they cannot be fitted."""
    try:
        given = loop_of_poses(arm, fixture, poses, unsensed_joints=unsensed)
        model, stated = free_within_tolerance(given, arm)
        sd = np.maximum(_by_files(model, arm, fixture, stated), EXACT)
        nominal = nominal_vector(model.parameters)
        rough = estimate_paper(given, poses.q_rad)
        x0 = in_order(model, given, rough.x)
        noise = stated_noise(arm, fixture, poses)
        prior = ParameterPrior(mean=nominal, precision=sd**-2)
        found = fit_implicit(model, poses.q_rad, noise, x0, prior=prior)
    except (SolverError, FixtureError, np.linalg.LinAlgError):
        return None
    if not found.converged or not np.isfinite(found.covariance).all():
        return None
    return StatedFit(model=model, nominal=nominal, sd=sd, fit=found)


def known_arm(
    arm: ArmModel, fixture: EndpointConstraint, poses: PoseSet, unsensed: tuple[int, ...] = ()
) -> KnownArm | None:
    """Return the information from poses of earlier placements; None where there is none yet."""
    by = stated_fit(arm, fixture, poses, unsensed)
    if by is None:
        return None
    model, found = by.model, by.fit
    own = set(model.ground_side) | (set() if fixture.stays_on_hand else set(model.hand_side))
    shared, stood, ends = list[int](), list[int](), dict[str, list[float]]()
    for k, p in enumerate(model.parameters):
        if p.name not in own:
            shared.append(k)
        elif p.name.startswith("theta_off_"):
            ends.setdefault(p.name.partition("[")[0], []).append(float(found.x[k]))
        else:
            stood.append(k)
    pulls = (found.x - by.nominal)[stood] / by.sd[stood]
    # Poses that fit worse than stated carry less information: their covariance is scaled up.
    worse = max(1.0, found.chi2 / found.dof)
    return KnownArm(
        names=tuple(model.parameters[k].name for k in shared),
        values=found.x[shared],
        covariance=worse * found.covariance[np.ix_(shared, shared)],
        ends={name: float(np.mean(values)) for name, values in ends.items()},
        placements=len(poses.placements),
        placement_ratio=max(1.0, float(np.sqrt(np.mean(pulls**2)))) if stood else 1.0,
    )


def _by_files(
    model: ClosureModel, arm: ArmModel, fixture: EndpointConstraint, stated: Mapping[str, float]
) -> FloatArray:
    """Standard deviation (P,) of each unknown.

    An offset has at least the uncertainty of a protractor, even if the arm's file states less, as the arm may not be
    calibrated yet.
    """
    offset = max(ROUGH_PLACEMENT.orientation_rad / WITHIN, arm.offset_tolerance_rad or 0.0)
    tolerance = fixture.tolerance
    sides, sd = {*model.ground_side, *model.hand_side}, []
    for p in model.parameters:
        placed = (tolerance.orientation_rad if p.is_angle else tolerance.position_m) / WITHIN
        if p.name.startswith("theta_off_"):
            sd.append(max(offset, placed if p.name in sides else 0.0))
        else:
            sd.append(
                max(placed, stated.get(p.name, 0.0))
                if p.name in sides
                else stated.get(p.name, placed)
            )
    return np.array(sd)


GATE_ROUNDS, LONGEST_STEP, CLOSURE_TOLERANCE = 40, 0.5, 1e-6
"""Most steps, the longest step (rad, m), and the error (rad, m) below which a loop is closed."""

LEAST_READING_RAD = float(np.deg2rad(0.1))
"""Least standard deviation of a reading here, because this model has no deflections."""

UNKNOWN_RAD = math.pi
"""Standard deviation of an ignored reading."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosureFit:
    """The most probable way to close the loop at one reading.

    `chi2`: chi2 of the necessary changes; infinite where it does not close at all. `dof`: equations of the pose minus
    ignored readings. `q_rad`: joint angles (n,) at which it closes.
    """

    chi2: float
    dof: int
    q_rad: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopAtReading:
    """The loop at one reading, with the prior from its files.

    `model`, `prior`: the loop, and the prior of its unknowns. `reading_rad`, `reading_sd_rad`: readings (n,) and their
    standard deviations.
    """

    model: ClosureModel
    prior: PlacementPrior
    reading_rad: FloatArray
    reading_sd_rad: FloatArray

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints (1-based) whose readings are used."""
        return tuple(
            j for j in range(1, len(self.reading_rad) + 1) if j not in self.model.unsensed_joints
        )

    def fit(self, *ignored_joints: int) -> ClosureFit:
        """Close the loop without the readings of `ignored_joints` (1-based)."""
        model, x0, q0 = self.model, self.prior.mean, self.reading_rad
        S, Q = self.prior.covariance, self.reading_sd_rad**2
        unknown = [j - 1 for j in ignored_joints]
        Q[unknown] = UNKNOWN_RAD**2
        x, q = x0.copy(), q0.copy()
        u = model.initial_unsensed(x, q[None])
        dof, size, moved, by_prior = 0, np.inf, np.inf, 0.0
        for _ in range(GATE_ROUNDS):
            error = model.loop(x, q[None], u)
            size = float(np.abs(error.residual).max())
            if size < CLOSURE_TOLERANCE and moved < CLOSURE_TOLERANCE:
                break
            reduced = reduced_equations(error)
            w, A, B = reduced.w[0], reduced.A[0], reduced.B[0]
            dof = len(w)
            of_x = A @ S @ A.T
            V = of_x + (B * Q) @ B.T
            pull = np.linalg.lstsq(V, w - A @ (x - x0) - B @ (q - q0), rcond=1e-12)[0]
            dx, dq = x0 - S @ (A.T @ pull) - x, q0 - Q * (B.T @ pull) - q
            by_prior = float(pull @ of_x @ pull)
            moved = max(float(np.abs(dx).max(initial=0.0)), float(np.abs(dq).max()))
            share = min(1.0, LONGEST_STEP / max(moved, 1e-300))
            dx, dq = share * dx, share * dq
            u = u + unsensed_step(error, (error.jac_x @ dx + (error.jac_q @ dq[..., None])[..., 0]))
            x, q = x + dx, q + dq
        if not size < CLOSURE_TOLERANCE:
            return ClosureFit(chi2=math.inf, dof=dof, q_rad=q)
        by_readings = np.where(Q > 0.0, (q - q0) ** 2 / np.where(Q > 0.0, Q, 1.0), 0.0)
        by_readings[unknown] = 0.0
        left = max(dof - len(unknown), 0)
        return ClosureFit(chi2=by_prior + float(by_readings.sum()), dof=left, q_rad=q)


def loop_at_reading(
    arm: ArmModel,
    fixture: EndpointConstraint,
    reading_rad: FloatArray,
    *,
    unsensed_joints: tuple[int, ...] = (),
    known: KnownArm | None = None,
) -> LoopAtReading:
    """Return the loop at a reading (n,), with the prior from its files and from the arm as far as `known`."""
    model, stated = free_within_tolerance(fixture.model(arm, unsensed_joints=unsensed_joints), arm)
    errors = np.stack(
        [
            arm.sigma_rad(),
            arm.linearity_rad(),
            arm.gain_rad(),
            arm.accuracy_rad,
            arm.backlash_rad,
            arm.sag_rad,
        ]
    )
    read = np.hypot(np.sqrt((errors**2).sum(0)), LEAST_READING_RAD)
    unsensed = [isinstance(j.sensor, NoSensor) for j in arm.joints]
    return LoopAtReading(
        model=model,
        prior=placement_prior(model, arm, fixture, stated, known),
        reading_rad=np.asarray(reading_rad, dtype=np.float64),
        reading_sd_rad=np.where(unsensed, 0.0, read),
    )
