"""Joint drives on the bus (frames and objects of a `Drive`), and the group of drives with the plant.

TPDO1 and RPDO1 are packed by `struct`, for speed; a test compares their layouts with the EDS file.
"""

import struct
from collections.abc import Sequence
from typing import Final

import numpy as np

from hardware.arm import JointMode
from hardware.canopen import cia402, objects
from hardware.canopen.objects import JOINT_PRODUCT, NmtState
from hardware.virtual.axis import AxisSettings, JointCommand
from hardware.virtual.drive import Drive
from hardware.virtual.node import Send, VirtualNode
from hardware.virtual.plant import Plant

RPDO1: Final = struct.Struct("<Hlb")
"""Layout of RPDO1, which is acted on when received: controlword, target position in counts, mode."""
TPDO1: Final = struct.Struct("<Hlh")
"""Layout of TPDO1, which is sent on every SYNC: statusword, position in counts, torque in per mille of rated torque."""
RIPPLE_COUNTS: Final = 10.0
"""Standard deviation of the noise of fault ``ripple``: five times that of an RVDT of the paper's arm."""
DIVERGENCE_STEP_COUNTS, DIVERGENCE_COUNTS = 20, 5556
"""Distance of a joint from its target in fault ``stray``: growth per control period, and final value, which is 5 deg
with 400,000 counts per turn."""
_HIGHEST_I16: Final = 2**15 - 1
_HIGHEST_I32: Final = 2**31 - 1


class DriveNode(VirtualNode):
    """Node of one joint; node number = joint number. With `reports_speed`, TPDO1 has the speed, not the position."""

    def __init__(self, axis: AxisSettings, send: Send, *, serial_number: int) -> None:
        super().__init__(axis.joint, send, product=JOINT_PRODUCT, serial_number=serial_number)
        self.axis = axis
        self.drive = Drive(axis, self.faults, on_emergency=self.send_emergency)
        self.tpdo1_id = objects.COB_TPDO1 + self.number
        self.home_offset_counts = 0
        self.reports_speed = False
        self.lost_tpdos = 0
        """Number of TPDO1 still to be lost."""
        self.lost_counts = 0
        """Offset of the sensor's readings; the drive follows the changed readings."""
        self.diverged_counts = 0
        """Distance of the joint from its drive's target."""
        self._per_mille = 1000.0 / axis.max_torque_nm
        self._serve_objects()

    def on_rpdo1(self, data: bytes | bytearray) -> None:
        """Act on an RPDO1; ignore it if its length is wrong or the node is not *operational*."""
        if len(data) == RPDO1.size and self.state is NmtState.OPERATIONAL:
            self.drive.obey(*RPDO1.unpack(data))

    def tpdo1(self) -> bytes | None:
        """Return the data of TPDO1; None if the node is not *operational*, or if this TPDO1 is lost."""
        if self.state is not NmtState.OPERATIONAL:
            return None
        if self.lost_tpdos:
            self.lost_tpdos -= 1
            return None
        position = self._speed() if self.reports_speed else self.drive.counts
        position = max(-_HIGHEST_I32 - 1, min(_HIGHEST_I32, position))
        return TPDO1.pack(self.drive.statusword, position, self._torque_per_mille())

    def power_up(self) -> None:
        """Power up the drive; `home_offset_counts` keeps its value until the supervisor sets another."""
        super().power_up()
        self.drive.power_up()

    def left_operational(self) -> None:
        """Stop and hold the joint, because no further command can arrive by PDO."""
        self.drive.quick_stop()

    def _speed(self) -> int:
        """Return 606Ch (actual speed), counts/s."""
        return round(self.drive.speed_rad_per_s * self.axis.scale.counts_per_rad)

    def _torque_per_mille(self) -> int:
        value = round(self.drive.torque_nm * self._per_mille)
        return max(-_HIGHEST_I16, min(_HIGHEST_I16, value))

    def _serve_objects(self) -> None:
        axis, drive = self.axis, self.drive
        self.answers |= {
            (objects.FOLLOWING_WINDOW, 0): axis.following_window_counts,
            (objects.RATED_TORQUE, 0): round(axis.max_torque_nm * 1e3),
            (objects.POSITION_LIMITS, 1): axis.limits.lower_counts,
            (objects.POSITION_LIMITS, 2): axis.limits.upper_counts,
            (objects.MAX_VELOCITY, 0): axis.max_speed_counts_per_s,
            (objects.ENCODER_RESOLUTION, 1): axis.increments,
            (objects.ENCODER_RESOLUTION, 2): axis.revolutions,
            (objects.SENSOR, objects.SENSOR_KIND): int(axis.sensor_kind),
            (objects.SENSOR, objects.SENSOR_FULL_SCALE): axis.full_scale_microdeg,
            (objects.SENSOR, objects.SENSOR_BITS): axis.converter_bits,
            (objects.TARGET_TORQUE, 0): 0,
            (objects.HOME_OFFSET, 0): lambda: self.home_offset_counts,
            (objects.ERROR_CODE, 0): lambda: drive.errors[-1] if drive.errors else 0,
            (objects.CONTROLWORD, 0): lambda: drive.controlword,
            (objects.STATUSWORD, 0): lambda: drive.statusword,
            (objects.MODE, 0): lambda: drive.mode_request,
            (objects.MODE_DISPLAY, 0): (
                lambda: 0 if drive.mode is None else objects.MODE_CODE[drive.mode]
            ),
            (objects.POSITION_ACTUAL, 0): lambda: drive.counts,
            (objects.VELOCITY_ACTUAL, 0): self._speed,
            (objects.TORQUE_ACTUAL, 0): self._torque_per_mille,
            (objects.TARGET_POSITION, 0): lambda: drive.target_counts,
        }
        self.writers |= {
            objects.CONTROLWORD: drive.obey_controlword,
            objects.MODE: drive.ask_for_mode,
            objects.TARGET_TORQUE: lambda _: None,  # only 0 is in the range of 6071h
            objects.TARGET_POSITION: drive.obey_target,
        }


class DriveGroup:
    """Drives of joints 1..n, with their plant.

    If one drive trips, all others stop (not in CiA 402): in a closed chain, a drive that went on would push against the
    tripped joint. No drive moves until the fault is reset. If the operator's heartbeat is lost, the drives hold
    position and raise 8130h. When the control token is released, all drives stop and hold without a fault.
    """

    def __init__(self, drives: Sequence[DriveNode], plant: Plant) -> None:
        self.drives, self._plant = tuple(drives), plant
        self._rng = np.random.default_rng(0)

    def step(self) -> None:
        """Advance one control period: step the plant, pass the readings to the drives, stop all if one has tripped."""
        readings = self._plant.step([self._command_of(node) for node in self.drives])
        for node, counts, torque, speed in zip(self.drives, *readings, strict=True):
            node.drive.read(self._reading(node, counts), torque, speed)
        if any(node.drive.state in cia402.FAULT_STATES for node in self.drives):
            self.quick_stop()

    def _command_of(self, node: DriveNode) -> JointCommand:
        mode, target_rad = node.drive.command()
        if mode is JointMode.FREE and "blocked-joint" in node.faults:
            return None, target_rad
        if mode is JointMode.POSITION and "sagging-drive" in node.faults:
            return JointMode.FREE, target_rad
        error = node.diverged_counts - node.lost_counts
        if "stray" in node.faults:
            grown = node.diverged_counts + DIVERGENCE_STEP_COUNTS
            node.diverged_counts = min(grown, DIVERGENCE_COUNTS)
        return mode, target_rad + error / node.axis.scale.counts_per_rad

    def _reading(self, node: DriveNode, counts: int) -> int:
        """Return a sensor's reading with the node's active faults; `counts`: the reading without faults."""
        if "frozen-sensor" in node.faults:
            return node.drive.counts
        noise = round(self._rng.normal(0.0, RIPPLE_COUNTS)) if "ripple" in node.faults else 0
        return counts + node.lost_counts + noise

    def quick_stop(self) -> None:
        """Stop and hold every drive that is enabled."""
        for node in self.drives:
            node.drive.quick_stop()

    def control_changed(self, holder: int) -> None:
        """Report to all drives that node `holder` took control or, if `holder` is 0, that control was released."""
        for node in self.drives:
            node.drive.in_control = holder != 0
        if holder == 0:
            self.quick_stop()

    def set_home_offsets(self, counts: Sequence[int]) -> None:
        """Set the home offsets (607Ch) of joints 1..n, counts; may be called from any thread."""
        for node, offset in zip(self.drives, counts, strict=True):
            node.home_offset_counts = offset
