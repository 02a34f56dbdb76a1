"""The controller's way onto its bus: sends for its nodes what faults let through. Knows no node's job."""

from __future__ import annotations

import can
import canopen

from hardware.virtual.faults import Disturbances

_NODE_BITS = 0x7F


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
        if self._cut and can_id & _NODE_BITS in self._cut:
            return
        message = can.Message(
            arbitration_id=can_id, data=data, is_extended_id=False, is_remote_frame=remote
        )
        wire = self._disturbances.wire
        with self.send_lock:
            if wire is None:
                self._out.send(message)
                return
            for passed in wire.passed(message):
                self._out.send(passed)
