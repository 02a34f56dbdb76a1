"""Letting go of an arm, and clearing its STOP: what it knows no more afterwards is kept first.

Why it was stopped by itself, and how late this computer was. Knows no bus and no screen.
"""

from __future__ import annotations

from contextlib import suppress

from hardware.arm import Arm, TellsPower
from hardware.errors import HardwareError
from operator_app.errors import NotLetGoError
from operator_app.session.safety.latency import LatenessLog
from operator_app.session.safety.sensor_faults import SensorFaults
from operator_app.session.store.journal import Journal


class Parting:
    """Parts a session from its arm.

    Attributes
    ----------
    held
        Whether the arm answered when it was let go of last, and no drive of it follows commands.
    powered
        Joints whose drives said then that they were powered; STOP leaves them so, and held.
    """

    def __init__(
        self, arm: Arm, journal: Journal, sensor_faults: SensorFaults, lateness: LatenessLog
    ) -> None:
        self._arm, self._journal = arm, journal
        self._sensor_faults, self._lateness = sensor_faults, lateness
        self.held = False
        self.powered: tuple[int, ...] = ()

    def reset_stop(self) -> None:
        """Clear STOP and what tripped; the drives stay disabled.

        Raises
        ------
        JournalError
            It could not be kept why the arm was stopped: nothing was cleared.
        Stopped, DriveFault, BusError
            As `Arm.reset_stop`.
        """
        with suppress(HardwareError):
            self._sensor_faults.heed()
        self._arm.reset_stop()

    def let_go(self) -> bool:
        """Leave the arm held; False if it is not. Whatever can be kept or not, it is let go.

        Raises
        ------
        JournalError
            What the arm knew could not be kept.
        """
        try:
            if not self._journal.closed and self._journal.loss is None:
                with suppress(HardwareError):
                    self._sensor_faults.heed()
                with suppress(HardwareError):
                    self._lateness.record()
        finally:
            self.held = self._arm.close()
            self.powered = self._arm.left_powered if isinstance(self._arm, TellsPower) else ()
        return self.held

    @property
    def not_held(self) -> NotLetGoError | None:
        """Why nobody may say that the arm is held; None where it is."""
        return None if self.held else NotLetGoError(self.powered)

    def require_off(self) -> None:
        """Refuse to send anybody to the fixture of an arm whose drives are not known to be off.

        Raises
        ------
        NotLetGoError
            Some are powered, if only because STOP holds them; or the arm did not answer when it was let go.
        """
        if self.powered or not self.held:
            raise NotLetGoError(self.powered)
