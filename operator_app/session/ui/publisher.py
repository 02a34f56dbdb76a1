"""Where the worker's operations put what they found, and hear that they should end. Knows no thread."""

from __future__ import annotations

from typing import Protocol

from operator_app.session.ui.snapshot import Change, Level


class Publisher(Protocol):
    """Where operations put what they found, and hear that they should end."""

    def publish(self, change: Change) -> None:
        """Put the changed snapshot in the place of the present one."""
        ...

    def say(self, level: Level, text: str) -> None:
        """Tell the operator."""
        ...

    def cancelled(self) -> bool:
        """Whether the operator wants this ended."""
        ...
