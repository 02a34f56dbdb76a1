"""The controller's way onto its bus: sends for its nodes what faults let through. Knows no node's job."""

from __future__ import annotations

import struct

import can
import canopen

from hardware.buses.shared_bus import Frame
from hardware.canopen.objects import COB_SDO_FROM_SERVER, COB_SDO_TO_SERVER, Abort
from hardware.virtual.disturbances import Disturbances

_NODE_BITS = 0x7F
_ABORT, _ABORTED = 0x80, struct.Struct("<B3sI")


class ControllerNetwork(canopen.Network):
    """A `canopen.Network` on a bus that is already open, without a receiving thread of its own.

    Parameters
    ----------
    bus
        The bus; it stays open when the controller ends.
    disturbances
        Frames of nodes whose cable is cut are not sent; a bad wire has its way with the others.
    """

    def __init__(self, bus: can.BusABC, disturbances: Disturbances) -> None:
        super().__init__(bus)
        self._out = bus
        self._cut, self._disturbances = disturbances.cut_since_s, disturbances

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:  # noqa: FBT001, FBT002
        """Send a frame; safe from any thread."""
        if self._disturbances.off_until_s is not None:
            return
        if self._cut and can_id & _NODE_BITS in self._cut:
            return
        message = Frame(
            arbitration_id=can_id, data=data, is_extended_id=False, is_remote_frame=remote
        )
        wire = self._disturbances.wire_out
        with self.send_lock:
            if wire is None:
                self._out.send(message)
                return
            for passed in wire.passed(message):
                self._out.send(passed)

    def send_overdue(self) -> None:
        """Send what a bad wire held back, as far as its time has come."""
        wire = self._disturbances.wire_out
        if wire is not None:
            with self.send_lock:
                for message in wire.overdue():
                    self._out.send(message)

    def notify(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Hand a frame on to whom it is for, unless a fault keeps that node from object access."""
        node = can_id - COB_SDO_TO_SERVER
        if node in self._disturbances.stalled_sdo:
            return
        if node in self._disturbances.refused_sdo and data[0] != _ABORT:
            answer = _ABORTED.pack(_ABORT, bytes(data[1:4]), Abort.GENERAL)
            self.send_message(COB_SDO_FROM_SERVER + node, answer)
            return
        super().notify(can_id, data, timestamp)
