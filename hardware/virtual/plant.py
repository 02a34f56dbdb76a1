"""The arm in its fixture as a quasi-static compliant closed chain.

At calibration speeds, the damping of hydraulic joints far outweighs their inertia. The true angles theta are the hinge
angle (unused without a hinge), then the joint angles. With k the stiffness of a servo, K that of the fixture, e the
closure error and d the damping (backward Euler), the increment D of theta in a control period dt minimises

    1/2 sum_position k (target - theta - D)^2 + 1/2 e(theta + D)' K e(theta + D)
        + 1/2 sum d D^2 / dt - gravity' D + friction(D)

An arm of seven joints in a hinge has mobility 2. With one servo only, gravity makes the arm sag. A third servo strains
against the first two, unless its target agrees with theirs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from scipy.linalg.lapack import dposv

from hardware.arm import JointMode
from hardware.canopen.objects import CONTROL_PERIOD_S
from hardware.virtual.axis import JointCommand, JointSensor, PlantReading
from hardware.virtual.true_loop import Truth
from solver.arrays import FloatArray, frozen
from solver.chain.arm_model import ArmModel

CONVERGED_RAD = 1e-9
"""Newton's method stops after a step this small: it converges fast, so the next step would be far smaller."""
MAX_NEWTON_STEPS = 12
RESTING_RAD = 1e-13
"""Under unchanged commands, increments below this (far less than a count) are neglected: the chain is at rest."""
BOUND_HINGE_NM_PER_RAD = 6e4
"""Stiffness of a blocked hinge: ten times that of a servo."""
MAX_NEWTON_STEP_RAD = 0.1
"""Largest Newton step: near a singularity, a joint would jump with a longer one, and the chain could not follow."""
PRESLIDING_RAD = 1e-3
"""Elastic motion of a joint before it slides."""
SERVO_NM_PER_RAD = 6e3
"""Stiffness in position mode, and of a blocked valve."""
DAMPING_NM_S_PER_RAD, HINGE_DAMPING_NM_S_PER_RAD = 5.0, 0.5
"""Viscous damping of every joint and of the hinge, which makes the equations of every step solvable."""
GRAVITY_M_PER_S2 = 9.81
PAPER_DOWN = frozen([-1.0, 0.0, 0.0])
"""Direction of gravity in frame 0, the arm's base: z_0, the first shoulder axis, is horizontal."""
PAPER_TORQUE_NM = 100.0
"""Torque limit of the paper's arm in its file."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Loads:
    """Stiffness of the fixture, equal in all directions, and the loads on the arm.

    `friction_nm` (n,): dry friction of each joint. `payload_kg` (n,): uncompensated mass at the origin of each of
    frames 1..n. `down` (3,): unit vector along gravity in frame 0.
    """

    fixture_n_per_m: float
    fixture_nm_per_rad: float
    friction_nm: FloatArray
    payload_kg: FloatArray
    down: FloatArray = field(default_factory=lambda: PAPER_DOWN)

    def __post_init__(self) -> None:
        for name in ("friction_nm", "payload_kg", "down"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    def of(self, arm: ArmModel) -> Self:
        """Return these loads adapted to `arm`: gravity from the arm file, friction proportional to the torque limits.

        If the arm's weakest drive is weaker than the paper's, all masses are reduced in proportion. If these loads are
        for another number of joints than the arm's n, frames n // 2 and n - 2 each carry the largest mass, others none.
        """
        weakest = min(joint.max_torque_nm for joint in arm.joints) / PAPER_TORQUE_NM
        n, payload = arm.joint_count, self.payload_kg * min(1.0, weakest)
        placed = payload
        if n != len(payload):
            placed = np.zeros(n)
            placed[[n // 2 - 1, max(n - 3, 0)]] = float(payload.max())
        share = self.friction_nm.max() / PAPER_TORQUE_NM
        friction = share * np.array([joint.max_torque_nm for joint in arm.joints])
        return replace(self, payload_kg=placed, friction_nm=friction, down=np.array(arm.down))


class Plant:
    """True geometry, loads and sensors of an arm; `rng` draws the sensors' noise.

    `start_rad` (n + 1,) are the true hinge angle and joint angles theta' of a closed pose, rad.
    """

    def __init__(
        self,
        *,
        truth: Truth,
        loads: Loads,
        sensors: Sequence[JointSensor],
        rng: np.random.Generator,
        start_rad: FloatArray,
    ) -> None:
        n = truth.loop.joint_count
        self.truth = truth
        self.sensors, self._rng = tuple(sensors), rng
        self._angles = start_rad
        self._offsets = np.concatenate(([0.0], truth.offsets_rad))
        self._last = self._last_but_one = np.zeros(n + 1)
        self._drive: bytes | None = None
        self._bristle = np.zeros(n + 1)
        self._valve: list[float | None] = [None] * n
        self._point = truth.point()
        self._slip = np.zeros(len(self._point.error))
        self._bound_at: float | None = None
        # Rotations, then positions; a ball has positions only, an open arm no components.
        stiffness = [loads.fixture_nm_per_rad] * 3 + [loads.fixture_n_per_m] * 3
        self._fixture = np.diag(stiffness[6 - len(self._point.error) :])
        self._point.at(self._angles)
        d = np.full(n + 1, DAMPING_NM_S_PER_RAD)
        d[0] = HINGE_DAMPING_NM_S_PER_RAD
        self._damping = d / CONTROL_PERIOD_S
        self._friction = np.concatenate(([0.0], loads.friction_nm))
        self._rubs = bool(np.any(self._friction > 0.0))
        self._loaded = bool(np.any(loads.payload_kg > 0.0))
        self._lever, self._across = _gravity_levers(loads)

    @property
    def true_angles_rad(self) -> FloatArray:
        """True hinge angle and joint angles theta', shape (n + 1,); never sent on the bus."""
        return self._angles.copy()

    @property
    def closure_error(self) -> FloatArray:
        """Deflection of the fixture, (6,): rotation vector (rad), position (m). Ball: position (3,). Open arm: (0,)."""
        return self._point.error + self._slip

    def slip(self, slip_m: float) -> None:
        """Shift the fixture by `slip_m` along x of its frame; no effect without a fixture."""
        self._slip[-3:-2] += slip_m
        self._drive = None

    def bind_hinge(self) -> None:
        """Block the hinge; no effect without a hinge."""
        self._bound_at = float(self._angles[0])

    def step(self, commands: Sequence[JointCommand]) -> PlantReading:
        """Advance one control period with the commands of joints 1..n."""
        stiffness, target = self._servos(commands)
        drive = stiffness.tobytes() + np.where(stiffness > 0.0, target, 0.0).tobytes()
        if drive != self._drive or float(np.abs(self._last).max()) > RESTING_RAD:
            self._advance(stiffness, target)
        self._drive = drive
        angles = self._angles
        torque = stiffness * (target - angles)
        speed = self._last / CONTROL_PERIOD_S
        noise = self._rng.standard_normal(len(self.sensors)).tolist()
        sensed = zip(self.sensors, (angles - self._offsets)[1:].tolist(), noise, strict=True)
        counts = tuple(sensor.counts(angle, draw) for sensor, angle, draw in sensed)
        return PlantReading(counts, tuple(torque[1:].tolist()), tuple(speed[1:].tolist()))

    def _servos(self, commands: Sequence[JointCommand]) -> tuple[FloatArray, FloatArray]:
        """Return servo stiffness (N m/rad) and true target angle (rad) of hinge and joints, shape (n + 1,)."""
        stiffness, target = np.zeros(len(self._angles)), self._angles.copy()
        if self._bound_at is not None:
            stiffness[0], target[0] = BOUND_HINGE_NM_PER_RAD, self._bound_at
        now = self._angles.tolist()
        offsets = self._offsets.tolist()
        for j, (mode, target_rad) in enumerate(commands, start=1):
            if mode is None:
                # A blocked valve holds the joint where it closed.
                closed_at = self._valve[j - 1]
                if closed_at is None:
                    closed_at = self._valve[j - 1] = now[j]
                target[j] = closed_at
            else:
                self._valve[j - 1] = None
                if mode is JointMode.FREE:
                    continue
                # The drive controls its sensor's reading, deviation included.
                deviation = self.sensors[j - 1].deviation_rad(now[j] - offsets[j])
                target[j] = target_rad - deviation + offsets[j]
            stiffness[j] = SERVO_NM_PER_RAD
        return stiffness, target

    def _advance(self, stiffness: FloatArray, target: FloatArray) -> None:
        """Advance the true angles by a period (Newton's method), with servos of `stiffness` and `target` (n + 1,)."""
        start, point, K = self._angles, self._point, self._fixture
        gravity = self._gravity() if self._loaded else 0.0
        diagonal = stiffness + self._damping
        angles = start + (2.0 * self._last - self._last_but_one)  # extrapolated
        for _ in range(MAX_NEWTON_STEPS):
            point.at(angles)
            J = point.jacobian
            KJ = K @ J
            force = stiffness * (target - angles) - self._damping * (angles - start) + gravity
            force -= self.closure_error @ KJ
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
            # Not converged: the next period is extrapolated from this one's motion alone.
            self._last = angles - start
        self._last_but_one, self._last = self._last, angles - start
        if self._rubs:
            self._bristle = np.clip(self._bristle + self._last, -PRESLIDING_RAD, PRESLIDING_RAD)
        self._angles = angles

    def _rub(self, increment: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return friction (n + 1,), N m, after a motion `increment`, and its derivative, N m/rad (0 while sliding)."""
        deflection = (self._bristle + increment) / PRESLIDING_RAD
        slope = np.where(np.abs(deflection) < 1.0, self._friction / PRESLIDING_RAD, 0.0)
        return self._friction * np.clip(deflection, -1.0, 1.0), slope

    def _gravity(self) -> FloatArray:
        """Return the torque (n + 1,) of the uncompensated masses about every joint axis, N m.

        Frame 0 is fixed to the table, so gravity has no torque about the hinge coordinate: entry 0 is zero.
        """
        axes = self._point.base_axes
        moment = self._lever @ self._point.origins_m @ (axes @ self._across @ axes.T)
        torque = np.zeros(len(self._angles))
        # g . (z x lever) = z . (lever x g)
        np.einsum("jk,jk->j", self._point.axes_z[1:-1], moment, out=torque[1:])
        return torque


def _gravity_levers(loads: Loads) -> tuple[FloatArray, FloatArray]:
    """Return M (n, n + 2), kg, and G (3, 3), m/s^2, two factors of the torques of gravity about the n joints.

    The product of M and the origins (n + 2, 3) of frames -1..n is mass times lever, (n, 3). The product of a row
    vector p and G is the cross product of p and the acceleration of gravity.
    """
    mass, g = loads.payload_kg, GRAVITY_M_PER_S2 * loads.down
    n = len(mass)
    lever = np.zeros((n, n + 2))
    # Joint j carries all masses from frame j on; their levers count from the origin of frame j - 1.
    lever[:, 2:] = np.triu(np.broadcast_to(mass, (n, n)))
    lever[np.arange(n), np.arange(n) + 1] -= np.cumsum(mass[::-1])[::-1]
    return lever, np.cross(np.eye(3), g)
