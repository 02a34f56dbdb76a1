"""Signals that end a run: the first as KeyboardInterrupt, none of them while the arm is made safe."""

from __future__ import annotations

import atexit
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
INTERRUPTED = 130
"""Exit code; `operator_app.exit_codes` has them all, and loads too much for the first moment of a process."""
AGAIN_S = 3.0
"""From the first signal on: a second one within it is the same wish, and must not interrupt what the first unwinds."""
THREADS_S = 1.5
"""How long threads may go on after the main one has ended."""

_first_s: float | None = None


def _interrupt(_number: int, _frame: object) -> None:
    global _first_s  # noqa: PLW0603 - as the handlers, one a process
    now_s = time.monotonic()
    if _first_s is None or now_s - _first_s > AGAIN_S:
        _first_s = now_s
        raise KeyboardInterrupt


def _nothing(_number: int, _frame: object) -> None:
    """Unlike SIG_IGN also for a signal that came just before, and not for programs that are started."""


def interrupted() -> bool:
    """Whether a signal has asked this process to end just now."""
    return _first_s is not None and time.monotonic() - _first_s < AGAIN_S


def press_ctrl_c() -> None:
    """Interrupt this process as a person would, however recently one did."""
    global _first_s  # noqa: PLW0603
    _first_s = None
    os.kill(os.getpid(), signal.SIGINT)


@contextmanager
def ending_signals_interrupt(*, for_good: bool = False) -> Iterator[None]:
    """Let SIGTERM and SIGHUP unwind the run as Ctrl-C does, once; within another such context it is that.

    `for_good`: the process ends afterwards, and no signal changes its exit code any more.
    """
    global _first_s  # noqa: PLW0603
    before = {number: signal.getsignal(number) for number in ENDING}
    if _interrupt in before.values() or threading.current_thread() is not threading.main_thread():
        yield
        return
    _first_s = None
    try:
        for number in ENDING:
            if number != signal.SIGHUP or before[number] != signal.SIG_IGN:  # nohup
                signal.signal(number, _interrupt)
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, signal.SIG_IGN if for_good else previous)


@contextmanager
def ending_signals_wait() -> Iterator[None]:
    """Let nothing interrupt: holding the arm and closing the journal take well under a second."""
    before = {number: signal.getsignal(number) for number in ENDING}
    while any(signal.getsignal(number) is not _nothing for number in ENDING):
        with suppress(BaseException):  # it came in time to be waited with
            for number in ENDING:
                signal.signal(number, _nothing)
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


class ProcessEnd:
    """Ends this process with its exit code, whatever threads and Python would have it be. Made once, early."""

    def __init__(self) -> None:
        # The last of all: they run in reverse order.
        atexit.register(self._if_interrupted)
        self._code = 0

    def soon(self, code: int) -> None:
        """End it with `code` soon after its main thread: a thread may wait for a terminal that is gone."""
        self._code = code
        threading.Thread(target=self._with_threads, daemon=True).start()

    def _with_threads(self) -> None:
        threading.main_thread().join()
        time.sleep(THREADS_S)
        os._exit(self._code)

    def _if_interrupted(self) -> None:
        """Python ends itself by SIGINT where the interrupt came in text that is executed, as dataclasses are."""
        if self._code == INTERRUPTED:
            for stream in (sys.stdout, sys.stderr):
                with suppress(OSError, ValueError):
                    stream.flush()
            os._exit(self._code)
