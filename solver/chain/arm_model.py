"""Data of a serial arm: D-H rows, ranges, sensors, limits; independent of file formats and controllers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhEntry, DhKind
from solver.chain.sensors import NoSensor, Sensor
from solver.chain.statics import UPRIGHT_DOWN, LinkMasses


@dataclass(frozen=True, slots=True, kw_only=True)
class Joint:
    """One sensed or unsensed revolute joint; `name` is shown to the operator.

    `lower_rad`, `upper_rad`: range in sensor coordinates (the measured angle theta, before the offset is added).
    `backlash_rad`: standard deviation of the play between sensor and link; 0 for none.
    `sag_rad`: standard deviation of the elastic twist under load; 0 for none.
    """

    name: str
    lower_rad: float
    upper_rad: float
    sensor: Sensor
    max_speed_rad_per_s: float
    max_torque_nm: float
    backlash_rad: float = 0.0
    sag_rad: float = 0.0

    @property
    def middle_rad(self) -> float:
        """Middle of the range, where an RVDT has its electrical zero."""
        return 0.5 * (self.lower_rad + self.upper_rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmModel:
    """A serial arm of n revolute joints.

    `name`: model name, e.g. ``sarcos_dextrous``. `joints`: joints 1..n.
    `table`: nominal D-H rows 1..n (`links` == n). Entries that a fixture determines (s_1, a_n, s_n, alpha_n) may have
    any value here: the fixture's nominal placement replaces them.
    `free`: entries of `table` that calibration identifies by default, in addition to the fixture's unknowns.
    `home_rad` (n,): pose the arm starts from, sensor coordinates.
    `length_tolerance_m`, `twist_tolerance_rad` (n,): standard deviation of s and a, and of alpha and beta, in each row
    of the maker's table, for entries that are fixed instead of identified. 0 means exact.
    `offset_tolerance_rad`: standard uncertainty of the nominal offsets; None if it is not known.
    `down`: unit vector along gravity in frame 0, the arm's base. `masses`: masses of the links; None if not stated.
    `hayati_rows`: rows that join parallel axes: they have beta_j in place of s_j, because s_j is not unique for them.
    `assumed`: default values of the error model that are used because the file states none, each as ``key: value``.
    """

    name: str
    table: DhTable
    joints: tuple[Joint, ...]
    free: tuple[DhEntry, ...]
    home_rad: FloatArray
    length_tolerance_m: FloatArray
    twist_tolerance_rad: FloatArray
    offset_tolerance_rad: float | None = None
    down: tuple[float, float, float] = UPRIGHT_DOWN
    masses: LinkMasses | None = None
    hayati_rows: tuple[int, ...] = ()
    assumed: tuple[str, ...] = ()

    @property
    def joint_count(self) -> int:
        """Number n of joints."""
        return len(self.joints)

    @property
    def lower_rad(self) -> FloatArray:
        """Lower ends of the ranges, shape (n,)."""
        return np.array([joint.lower_rad for joint in self.joints])

    @property
    def upper_rad(self) -> FloatArray:
        """Upper ends of the ranges, shape (n,)."""
        return np.array([joint.upper_rad for joint in self.joints])

    @property
    def unsensed_joints(self) -> tuple[int, ...]:
        """Joints (1-based) without a sensor."""
        return tuple(
            j for j, joint in enumerate(self.joints, 1) if isinstance(joint.sensor, NoSensor)
        )

    def with_length_tolerance(self, length_m: float | None) -> ArmModel:
        """Return the arm with `length_m` as standard deviation of every s and a; None leaves the arm unchanged."""
        if length_m is None:
            return self
        return replace(self, length_tolerance_m=np.full(self.joint_count, length_m))

    def maker_entries(self, row: int) -> tuple[DhEntry, ...]:
        """Lengths and twists of a row of the maker's table: a, s and alpha, or a, beta and alpha in `hayati_rows`."""
        s_or_beta = DhKind.BETA if row in self.hayati_rows else DhKind.S
        return tuple(DhEntry(kind, row) for kind in (DhKind.A, s_or_beta, DhKind.ALPHA))

    def sigma_rad(self) -> FloatArray:
        """Standard deviation of one reading of every joint, shape (n,); 0 without a sensor."""
        return np.array([joint.sensor.sigma_rad for joint in self.joints])

    def linearity_rad(self) -> FloatArray:
        """Largest linearity deviation that the specification of each RVDT allows, shape (n,); 0 for other sensors."""
        return np.array([joint.sensor.linearity_rad for joint in self.joints])

    def gain_rad(self) -> FloatArray:
        """Deviation (n,) at a gain error of one sigma: rms over the full scale, rad; 0 if the sensor is not an RVDT."""
        return np.array([joint.sensor.gain_rad for joint in self.joints])

    @property
    def accuracy_rad(self) -> FloatArray:
        """Standard deviation of each encoder's periodic errors (see `Encoder`), shape (n,); 0 for other sensors."""
        return np.array([joint.sensor.accuracy_rad for joint in self.joints])

    @property
    def backlash_rad(self) -> FloatArray:
        """Standard deviation of each joint's backlash, shape (n,)."""
        return np.array([joint.backlash_rad for joint in self.joints])

    @property
    def sag_rad(self) -> FloatArray:
        """Standard deviation of each joint's elastic twist under load, shape (n,)."""
        return np.array([joint.sag_rad for joint in self.joints])
