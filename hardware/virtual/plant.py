"""The arm in its fixture as a quasi-static compliant closed chain.

Hydraulic joints at calibration speeds are damped far above their inertia. In each control period the increment D of
the true angles (first the hinge's, or an unused angle without a hinge; then the joints') minimises

    1/2 sum_position k (target - theta - D)^2 + 1/2 e(theta + D)' K e(theta + D)
        + 1/2 sum d D^2 / dt - gravity' D + friction(D)

with e the closure error and K the fixture's stiffness (backward Euler of the overdamped chain). With a hinge two
drives move the arm; with one drive it sags, and a third with an inconsistent target builds up torque.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dposv

from hardware.arm import JointMode
from hardware.virtual.axis import JointCommand, PlantReading
from hardware.virtual.sensor_counts import SensorBank
from hardware.virtual.true_loop import Truth
from solver.arrays import FloatArray, frozen

CONVERGED_RAD = 1e-9
"""Newton stops after a step this small; convergence is fast, the next one would be far smaller."""
MAX_NEWTON_STEPS = 12
RESTING_RAD = 1e-13
"""Increment below which a chain under unchanged commands stays where it is: far below a count."""
BOUND_HINGE_NM_PER_RAD = 6e4
"""Stiffness of a blocked hinge: that of ten servos."""
MAX_NEWTON_STEP_RAD = 0.1
"""Largest step near a fold, where a joint would jump: the chain must be able to follow it."""


def fixture_stiffness(*, n_per_m: float, nm_per_rad: float, components: int = 6) -> FloatArray:
    """Stiffness (k, k) of a fixture, equal in all directions: rotations, then positions.

    Three `components` are positions; with none nothing is constrained.
    """
    return np.diag(([nm_per_rad] * 3 + [n_per_m] * 3)[6 - components :])


@dataclass(frozen=True, slots=True, kw_only=True)
class Dynamics:
    """Forces in the closed chain of n joints.

    Attributes
    ----------
    fixture
        (k, k) symmetric stiffness for the k components of the closure error (of hinge and rigid
        attachment rotation, then position, frame -1; of a ball position), N m/rad and N/m.
    payload_kg
        (n,) mass at the origins of frames 1..n that is not gravity-compensated.
    gravity_m_per_s2
        (3,) in frame 0, the arm's base.
    friction_nm
        (n,) dry friction of the joints.
    presliding_rad
        Elastic motion of a joint before it slides.
    servo_nm_per_rad
        Stiffness in position mode, and of a blocked valve.
    damping_nm_s_per_rad, hinge_damping_nm_s_per_rad
        Viscous damping of every joint and of the hinge.
    """

    fixture: FloatArray
    payload_kg: FloatArray
    gravity_m_per_s2: FloatArray
    friction_nm: FloatArray
    presliding_rad: float = 1e-3
    servo_nm_per_rad: float = 6e3
    damping_nm_s_per_rad: float = 5.0
    hinge_damping_nm_s_per_rad: float = 0.5
    period_s: float = 0.01

    def __post_init__(self) -> None:
        for name in ("fixture", "payload_kg", "gravity_m_per_s2", "friction_nm"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        k = len(self.fixture)
        if self.fixture.shape != (k, k) or self.gravity_m_per_s2.shape != (3,):
            raise ValueError("the fixture's stiffness is square, gravity has three components")
        if self.payload_kg.shape != self.friction_nm.shape:
            raise ValueError("payload and friction need one entry per joint each")
        if min(self.damping_nm_s_per_rad, self.hinge_damping_nm_s_per_rad, self.period_s) <= 0.0:
            raise ValueError("damping and period must be positive: they keep every step solvable")


class Plant:
    """True geometry, forces and the sensors of joints 1..n.

    `start_rad` (n,) and `start_hinge_rad` are true joint angles theta' and hinge angle of a closed pose, rad.
    """

    def __init__(
        self,
        *,
        truth: Truth,
        dynamics: Dynamics,
        sensors: SensorBank,
        start_rad: FloatArray,
        start_hinge_rad: float,
    ) -> None:
        n = truth.joint_count
        if len(sensors.sensors) != n or dynamics.payload_kg.shape != (n,):
            raise ValueError(f"truth, sensors and dynamics must all have {n} joints")
        self.joint_count = n
        self.truth = truth
        self.sensors = sensors
        self._dynamics = dynamics
        self._angles = np.concatenate(([start_hinge_rad], start_rad))
        self._offsets = np.concatenate(([0.0], truth.offsets_rad))
        self._last = self._last_but_one = np.zeros(n + 1)
        self._drive: bytes | None = None
        self._bristle = np.zeros(n + 1)
        self._valve: list[float | None] = [None] * n
        self._point = truth.point()
        self._slip = np.zeros(len(self._point.error))
        self._bound_at: float | None = None
        if len(dynamics.fixture) != len(self._point.error):
            raise ValueError("the fixture's stiffness is for another number of closure components")
        self._point.at(self._angles)
        d = np.full(n + 1, dynamics.damping_nm_s_per_rad)
        d[0] = dynamics.hinge_damping_nm_s_per_rad
        self._damping = d / dynamics.period_s
        self._friction = np.concatenate(([0.0], dynamics.friction_nm))
        self._rubs = bool(np.any(self._friction > 0.0))
        self._loaded = bool(np.any(dynamics.payload_kg > 0.0))
        self._lever, self._across = _gravity_levers(dynamics)

    @property
    def true_angles_rad(self) -> FloatArray:
        """True hinge angle and joint angles theta', shape (n + 1,); never sent on the bus."""
        return self._angles.copy()

    @property
    def closure_error(self) -> FloatArray:
        """Deflection of the fixture: closure components (k,), rotation vector (rad), then position (m)."""
        return self._point.error + self._slip

    def slip(self, slip_m: float) -> None:
        """Shift the fixture along x of its frame; no effect without one."""
        self._slip[-3:-2] += slip_m
        self._drive = None

    def bind_hinge(self) -> None:
        """Block the hinge; no effect without one."""
        self._bound_at = float(self._angles[0])

    def step(self, commands: Sequence[JointCommand]) -> PlantReading:
        """Advance one control period; `ValueError` for a wrong number of commands or a non-finite target."""
        n = self.joint_count
        if len(commands) != n:
            raise ValueError(f"{len(commands)} commands for {n} joints")
        stiffness, target = self._servos(commands)
        drive = stiffness.tobytes() + np.where(stiffness > 0.0, target, 0.0).tobytes()
        if drive != self._drive or float(np.abs(self._last).max()) > RESTING_RAD:
            self._advance(stiffness, target)
        self._drive = drive
        angles = self._angles
        torque = stiffness * (target - angles)
        speed = self._last / self._dynamics.period_s
        return PlantReading(
            position_counts=self.sensors.read((angles - self._offsets)[1:].tolist()),
            torque_nm=tuple(torque[1:].tolist()),
            speed_rad_per_s=tuple(speed[1:].tolist()),
        )

    def _servos(self, commands: Sequence[JointCommand]) -> tuple[FloatArray, FloatArray]:
        """Servo stiffness and true target angle of hinge and joints, shape (n + 1,)."""
        stiffness, target = np.zeros(self.joint_count + 1), self._angles.copy()
        if self._bound_at is not None:
            stiffness[0], target[0] = BOUND_HINGE_NM_PER_RAD, self._bound_at
        now = self._angles.tolist()
        offsets = self._offsets.tolist()
        for j, command in enumerate(commands, start=1):
            if command.mode is None:
                # A blocked valve holds the joint where it closed.
                closed_at = self._valve[j - 1]
                if closed_at is None:
                    closed_at = self._valve[j - 1] = now[j]
                target[j] = closed_at
            else:
                self._valve[j - 1] = None
                if command.mode is JointMode.FREE:
                    continue
                # The drive controls its sensor's reading, deviation included.
                deviation = self.sensors.sensors[j - 1].deviation_rad(now[j] - offsets[j])
                target[j] = command.target_rad - deviation + offsets[j]
            stiffness[j] = self._dynamics.servo_nm_per_rad
        if not np.all(np.isfinite(target)):
            raise ValueError("position targets must be finite")
        return stiffness, target

    def _advance(self, stiffness: FloatArray, target: FloatArray) -> None:
        """Newton's method for the increment, started from the extrapolated motion of the last two periods."""
        start, point, K = self._angles, self._point, self._dynamics.fixture
        gravity = self._gravity() if self._loaded else 0.0
        diagonal = stiffness + self._damping
        angles = start + (2.0 * self._last - self._last_but_one)
        for _ in range(MAX_NEWTON_STEPS):
            point.at(angles)
            J = point.jacobian
            KJ = K @ J
            force = stiffness * (target - angles) - self._damping * (angles - start) + gravity
            force -= (point.error + self._slip) @ KJ
            H = J.T @ KJ
            tangent = diagonal
            if self._rubs:
                rubbing, hardening = self._rub(angles - start)
                force -= rubbing
                tangent = diagonal + hardening
            H.flat[:: angles.size + 1] += tangent
            _, step, singular = dposv(H, force)
            if singular:
                raise np.linalg.LinAlgError(
                    "damping keeps every step solvable, and this one is not"
                )
            longest = float(np.abs(step).max())
            if longest > MAX_NEWTON_STEP_RAD:
                step *= MAX_NEWTON_STEP_RAD / longest
            angles = angles + step
            if longest < CONVERGED_RAD:
                break
        else:
            # No earlier motion: the next period starts from this one's motion alone.
            self._last = angles - start
        self._last_but_one, self._last = self._last, angles - start
        if self._rubs:
            limit = self._dynamics.presliding_rad
            self._bristle = np.clip(self._bristle + self._last, -limit, limit)
        self._angles = angles

    def _rub(self, increment: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Dry friction (n + 1,) N m against an increment, and its derivative: elastic at first, then sliding."""
        limit = self._dynamics.presliding_rad
        deflection = (self._bristle + increment) / limit
        slope = np.where(np.abs(deflection) < 1.0, self._friction / limit, 0.0)
        return self._friction * np.clip(deflection, -1.0, 1.0), slope

    def _gravity(self) -> FloatArray:
        """Torque (n + 1,) of the uncompensated masses about every joint axis, N m.

        Frame 0 stands on the table, so gravity has no torque about the hinge coordinate: entry 0 is zero.
        """
        axes = self._point.base_axes
        moment = self._lever @ self._point.origins_m @ (axes @ self._across @ axes.T)
        torque = np.zeros(self.joint_count + 1)
        # g . (z x lever) = z . (lever x g)
        np.einsum("jk,jk->j", self._point.axes_z[1:-1], moment, out=torque[1:])
        return torque


def _gravity_levers(dynamics: Dynamics) -> tuple[FloatArray, FloatArray]:
    """Signed masses (n, n + 2) that joints 1..n carry at origins -1..n, and G (3, 3) for which ``p x g = p @ G``."""
    mass, g = dynamics.payload_kg, dynamics.gravity_m_per_s2
    n = len(mass)
    lever = np.zeros((n, n + 2))
    # Everything from frame j on hangs on joint j, about the origin before it.
    lever[:, 2:] = np.triu(np.broadcast_to(mass, (n, n)))
    lever[np.arange(n), np.arange(n) + 1] -= np.cumsum(mass[::-1])[::-1]
    return lever, np.cross(np.eye(3), g)
