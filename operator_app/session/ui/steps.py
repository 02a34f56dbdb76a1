"""The seven steps of a calibration, and the keys for STOP and quit.

Imports no other module of this program, because the app needs the keys while it is loading.
"""

from enum import IntEnum


class Step(IntEnum):
    """Step of a calibration, in order."""

    CONNECT = 1
    FIXTURE = 2
    MODES = 3
    CAPTURE = 4
    CALIBRATE = 5
    RESULTS = 6
    EXPORT = 7

    @property
    def title(self) -> str:
        """Name of the step on the screen."""
        return self.name.capitalize()


STOP_KEYS = ("space", "f8")
QUIT_KEYS = ("q", "ctrl+q", "ctrl+c")
