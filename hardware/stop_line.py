"""STOP's own way to the drives: a second handle on the bus. Takes no lock, waits for nothing, knows no loop."""

from __future__ import annotations

from collections.abc import Sequence

import can

from hardware.cia402 import CONTROLWORD_QUICK_STOP
from hardware.cyclic import Command, Commands
from hardware.errors import BusError
from hardware.objects import COB_RPDO1, CYCLIC_POSITION, joint_node
from hardware.wire import Wire


class StopLine:
    """Sends quick stop to all drives.

    Parameters
    ----------
    bus
        Handle that nobody else sends on; `close` shuts it down.
    spare
        Where a frame goes that the handle does not take.
    """

    def __init__(self, bus: can.BusABC, spare: Wire) -> None:
        self._bus, self._spare = bus, spare

    def send(self, given: Commands | None, counts: Sequence[int]) -> None:
        """Quick stop to every drive; target and mode stay what they were.

        Parameters
        ----------
        given
            Commands sent last, None if there were none.
        counts
            Positions, one for each joint.

        Raises
        ------
        BusError
            If a frame could not be sent at all; the others were.
        """
        failure: Exception | None = None
        for at, measured in enumerate(counts):
            target = given[at].target_counts if given else measured
            mode = given[at].mode if given else CYCLIC_POSITION
            message = can.Message(
                arbitration_id=COB_RPDO1 + joint_node(at + 1),
                data=Command(CONTROLWORD_QUICK_STOP, target, mode).pack(),
                is_extended_id=False,
            )
            try:
                self._bus.send(message, timeout=0.0)
            except (can.CanError, OSError):
                try:
                    self._spare.send_at_once(message)
                except BusError as error:
                    failure = error
        if failure is not None:
            raise BusError(f"STOP could not be sent: {failure} Use the emergency stop.")

    def close(self) -> None:
        """Shut the handle down."""
        self._bus.shutdown()
