"""Standard input and output as plain mode's terminal. Knows no session."""

from __future__ import annotations

import select
import sys

from operator_app.safe_output import harmless, say


class StandardTerminal:
    """Lines on stdin and stdout."""

    def say(self, text: str) -> None:
        """Write lines at once."""
        say(text)
        sys.stdout.flush()

    def ask(self, prompt: str) -> str:
        """Return a line."""
        return input(harmless(prompt))

    def touched(self, timeout_s: float) -> bool:
        """Wait for a line; what a pipe already holds, and the end of the input, is no touch."""
        if not sys.stdin.isatty():
            select.select([], [], [], timeout_s)
            return False
        ready, _, _ = select.select([sys.stdin], [], [], timeout_s)
        return bool(ready) and bool(sys.stdin.readline())
