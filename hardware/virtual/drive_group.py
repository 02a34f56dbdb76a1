"""All drives of the arm and the plant they move: what concerns them together. Knows no bus and no clock.

Rules of the arm as a whole, beyond CiA 402:

- A drive that trips stops its neighbours: in a closed chain, one joint that no longer follows is a
  constraint that the others would push against. While one drive is in a fault none moves.
- Drives that lose the operator's heartbeat hold where they are and raise 8130h.
- When the control token is given back all drives stop and hold, without a fault.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hardware.arm import DriveState, JointMode
from hardware.canopen.objects import EmergencyCode
from hardware.virtual.disturbances import Disturbances
from hardware.virtual.drive_node import DriveNode
from hardware.virtual.port import JointCommand, PlantPort

_FAULTED = (DriveState.FAULT_REACTION_ACTIVE, DriveState.FAULT)


class DriveGroup:
    """Drives of joints 1..n and their plant.

    Parameters
    ----------
    drives
        Nodes of joints 1..n.
    plant
        What they move.
    disturbances
        Joints whose sensor or drive is not as it should be; looked at in every period.
    """

    def __init__(
        self,
        drives: Sequence[DriveNode],
        plant: PlantPort,
        disturbances: Disturbances,
    ) -> None:
        if len(drives) != plant.joint_count:
            raise ValueError(f"{len(drives)} axes for a plant of {plant.joint_count} joints")
        self._drives, self._plant, self._disturbances = tuple(drives), plant, disturbances

    def step(self) -> None:
        """One control period: commands out, readings in, trips."""
        reading = self._plant.step([self._command_of(node) for node in self._drives])
        for node, counts, torque, speed in zip(
            self._drives,
            reading.position_counts,
            reading.torque_nm,
            reading.speed_rad_per_s,
            strict=True,
        ):
            with node.lock:
                node.drive.read(self._disturbances.read(node.number, counts), torque, speed)
        if any(node.drive.state in _FAULTED for node in self._drives):
            self.quick_stop()

    def _command_of(self, node: DriveNode) -> JointCommand:
        """What a drive does: it goes by its own sensor, and so as far off as that one is."""
        command, wrong = node.drive.command(), self._disturbances
        if command.mode is JointMode.FREE and node.number in wrong.blocked:
            return replace(command, mode=None)
        if command.mode is JointMode.POSITION and node.number in wrong.sagging:
            return replace(command, mode=JointMode.FREE)
        off = wrong.astray(node.number) - wrong.lost_counts.get(node.number, 0)
        if not off:
            return command
        return replace(command, target_rad=command.target_rad + node.axis.scale.to_rad(off))

    def quick_stop(self) -> None:
        """Stop and hold every drive that is enabled."""
        for node in self._drives:
            with node.lock:
                node.drive.quick_stop()

    def lose_heartbeat(self) -> None:
        """The operator is gone for all drives."""
        for node in self._drives:
            with node.lock:
                node.drive.lose_heartbeat()

    def lose_heartbeat_at(self, joint: int) -> None:
        """The operator is gone for one drive, if it was under control and does not know yet."""
        node = self._drives[joint - 1]
        with node.lock:
            if node.drive.in_control and EmergencyCode.HEARTBEAT_LOST not in node.drive.errors:
                node.drive.lose_heartbeat()

    def control_changed(self, holder: int) -> None:
        """Somebody took the control token, or (0) nobody has it any more."""
        for node in self._drives:
            with node.lock:
                node.drive.in_control = holder != 0
        if holder == 0:
            self.quick_stop()

    def set_home_offsets(self, counts: Sequence[int]) -> None:
        """Give joints 1..n their 607Ch."""
        for node, offset in zip(self._drives, counts, strict=True):
            with node.lock:
                node.home_offset_counts = offset
