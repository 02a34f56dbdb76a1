"""Signals that end a run: all of them as KeyboardInterrupt, none of them while the arm is made safe."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def ending_signals_interrupt() -> Iterator[None]:
    """Let SIGTERM and SIGHUP unwind the run as Ctrl-C does."""
    with _handlers(signal.default_int_handler):
        yield


@contextmanager
def ending_signals_wait() -> Iterator[None]:
    """Let nothing interrupt: holding the arm and closing the journal take well under a second."""
    with _handlers(signal.SIG_IGN):
        yield


@contextmanager
def _handlers(handler: signal._HANDLER) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in ENDING}
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)
