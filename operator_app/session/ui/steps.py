"""The seven steps of a calibration by name and number. Knows nothing else."""

from __future__ import annotations

from enum import IntEnum


class Step(IntEnum):
    """Steps in the order in which they open."""

    CONNECT = 1
    FIXTURE = 2
    MODES = 3
    CAPTURE = 4
    CALIBRATE = 5
    RESULTS = 6
    EXPORT = 7

    @property
    def title(self) -> str:
        """What the operator reads."""
        return self.name.capitalize()


STOP_KEYS = ("space", "f8")
QUIT_KEYS = ("q", "ctrl+q", "ctrl+c")
