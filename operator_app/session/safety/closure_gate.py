"""Closure gate: whether the loop can close at the current readings within the tolerances of arm and fixture files.

The gate is used while there are too few poses to predict the closure. The most probable closure minimises

    (phi - phi_0)' S^-1 (phi - phi_0) + (q - reading)' Q^-1 (q - reading)   subject to   c(phi, q, u) = 0.

The unknowns are the parameters phi (prior mean phi_0, covariance S), the joint angles q (covariance Q of the readings)
and the unsensed angles u. c are the closure equations; `solver.closing` eliminates u from them. Newton's iteration on
the reduced equations finds the minimum, which is chi2-distributed with one degree of freedom for each such equation.
"""

import math
from dataclasses import dataclass

import numpy as np

from operator_app.calibration.error_model import free_within_tolerance
from operator_app.calibration.prior import KnownArm, placement_prior
from operator_app.config.procedure import Procedure
from solver.arrays import FloatArray
from solver.chain.sensors import NoSensor
from solver.closing import reduced_equations, unsensed_step

GATE_ITERATIONS, LONGEST_STEP, CLOSURE_TOLERANCE = 40, 0.5, 1e-6
"""Largest number of iterations; longest step (rad, m); closure error (rad, m) below which a loop counts as closed."""

LEAST_READING_RAD = float(np.deg2rad(0.1))
"""Smallest standard deviation assumed for a reading, because this model contains no deflections."""

UNKNOWN_RAD = math.pi
"""Standard deviation of an ignored reading."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosureFit:
    """The most probable closure of the loop at one reading.

    `chi2`: smallest value of the sum that the module minimises; infinite if the loop cannot close.
    `dof`: degrees of freedom of `chi2`, reduced by one for each ignored reading.
    `q_rad`: joint angles (n,) of the closed loop.
    """

    chi2: float
    dof: int
    q_rad: FloatArray


class LoopAtReading:
    """The loop at one reading (n,), rad, of the n joints.

    The loop's parameters have a prior from arm file and fixture file. `known` adds information from earlier placements.
    """

    def __init__(
        self, procedure: Procedure, reading_rad: FloatArray, known: KnownArm | None = None
    ) -> None:
        arm, fixture = procedure.arm, procedure.fixture.fixture
        loop = fixture.model(arm, unsensed_joints=procedure.unsensed_joints)
        self.model, stated = free_within_tolerance(loop, arm)
        self.mean, self.covariance = placement_prior(self.model, arm, fixture, stated, known)
        self.reading_rad = reading_rad
        of_sensor = (arm.sigma_rad(), arm.linearity_rad(), arm.gain_rad(), arm.accuracy_rad)
        errors = np.stack([*of_sensor, arm.backlash_rad, arm.sag_rad])
        read = np.hypot(np.sqrt((errors**2).sum(0)), LEAST_READING_RAD)
        unsensed = [isinstance(j.sensor, NoSensor) for j in arm.joints]
        self.reading_sd_rad: FloatArray = np.where(unsensed, 0.0, read)

    @property
    def joints(self) -> tuple[int, ...]:
        """Joints (1-based) whose readings are used."""
        return tuple(
            j for j in range(1, len(self.reading_rad) + 1) if j not in self.model.unsensed_joints
        )

    def fit(self, *ignored_joints: int) -> ClosureFit:
        """Return the most probable closure without the readings of `ignored_joints` (1-based)."""
        model, x0, q0 = self.model, self.mean, self.reading_rad
        S, Q = self.covariance, self.reading_sd_rad**2
        unknown = [j - 1 for j in ignored_joints]
        Q[unknown] = UNKNOWN_RAD**2
        x, q = x0.copy(), q0.copy()
        u = model.initial_unsensed(x, q[None])
        dof, size, displacement, by_prior = 0, np.inf, np.inf, 0.0
        for _ in range(GATE_ITERATIONS):
            error = model.loop(x, q[None], u)
            size = float(np.abs(error.residual).max())
            if size < CLOSURE_TOLERANCE and displacement < CLOSURE_TOLERANCE:
                break
            reduced = reduced_equations(error)
            w, A, B = reduced.w[0], reduced.A[0], reduced.B[0]
            dof = len(w)
            of_x = A @ S @ A.T
            V = of_x + (B * Q) @ B.T
            pull = np.linalg.lstsq(V, w - A @ (x - x0) - B @ (q - q0), rcond=1e-12)[0]
            dx, dq = x0 - S @ (A.T @ pull) - x, q0 - Q * (B.T @ pull) - q
            by_prior = float(pull @ of_x @ pull)
            displacement = max(float(np.abs(dx).max(initial=0.0)), float(np.abs(dq).max()))
            share = min(1.0, LONGEST_STEP / max(displacement, 1e-300))
            dx, dq = share * dx, share * dq
            u = u + unsensed_step(error, (error.jac_x @ dx + (error.jac_q @ dq[..., None])[..., 0]))
            x, q = x + dx, q + dq
        if not size < CLOSURE_TOLERANCE:
            return ClosureFit(chi2=math.inf, dof=dof, q_rad=q)
        by_readings = np.where(Q > 0.0, (q - q0) ** 2 / np.where(Q > 0.0, Q, 1.0), 0.0)
        by_readings[unknown] = 0.0
        dof_left = max(dof - len(unknown), 0)
        return ClosureFit(chi2=by_prior + float(by_readings.sum()), dof=dof_left, q_rad=q)
