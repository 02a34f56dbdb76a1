"""An arm as data: D-H rows, ranges, sensors, limits. Any serial arm; knows no file and no controller."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhEntry
from solver.chain.sensors import NoSensor, Rvdt, Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Joint:
    """One sensed or unsensed revolute joint.

    Attributes
    ----------
    name
        What the operator calls it.
    lower_rad, upper_rad
        Range in sensor coordinates (the measured angle theta, without the offset).
    sensor
        Its angle sensor.
    max_speed_rad_per_s, max_torque_nm
        Command and trip limits.
    """

    name: str
    lower_rad: float
    upper_rad: float
    sensor: Sensor
    max_speed_rad_per_s: float
    max_torque_nm: float

    @property
    def middle_rad(self) -> float:
        """Middle of the range, where an RVDT has its electrical zero."""
        return 0.5 * (self.lower_rad + self.upper_rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmModel:
    """A serial arm of n revolute joints.

    Attributes
    ----------
    name
        Model name, e.g. ``sarcos_dextrous``.
    table
        Nominal D-H rows 1..n (`links` == n). Entries a fixture determines (s_1, a_n, s_n, alpha_n)
        may be any value here: the fixture's nominal placement replaces them.
    joints
        Joints 1..n.
    free
        Entries that calibration identifies by default, beside the fixture's.
    home_rad
        Pose the arm starts from, sensor coordinates, shape (n,).
    """

    name: str
    table: DhTable
    joints: tuple[Joint, ...]
    free: tuple[DhEntry, ...]
    home_rad: FloatArray

    def __post_init__(self) -> None:
        if self.table.links != len(self.joints):
            raise ValueError("an arm needs one joint per D-H row")

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

    def sigma_rad(self) -> FloatArray:
        """Standard deviation of one reading of every joint, shape (n,); 0 without a sensor."""
        return np.array(
            [0.0 if isinstance(j.sensor, NoSensor) else j.sensor.sigma_rad for j in self.joints]
        )

    def linearity_rad(self) -> FloatArray:
        """Largest systematic deviation of each sensor by its specification, shape (n,)."""
        return np.array(
            [j.sensor.linearity_rad if isinstance(j.sensor, Rvdt) else 0.0 for j in self.joints]
        )
