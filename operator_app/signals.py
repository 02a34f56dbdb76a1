"""Signals that end a run: the first one raises KeyboardInterrupt; all are ignored while the arm is being released."""

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
"""Exit code, copied from `operator_app.exit_codes`, which takes too long to load at the start."""
AGAIN_S = 3.0
"""Time after a signal within which a further signal counts as a repetition, and does not interrupt the cleanup."""
THREADS_S = 1.5
"""Longest time that threads may run after the main thread has ended."""

_first_s: float | None = None


def _interrupt(_number: int, _frame: object) -> None:
    global _first_s  # noqa: PLW0603 - one per process, like the handlers
    now_s = time.monotonic()
    if _first_s is None or now_s - _first_s > AGAIN_S:
        _first_s = now_s
        raise KeyboardInterrupt


def _ignore(_number: int, _frame: object) -> None:
    """Ignore a signal, even one already pending; unlike SIG_IGN, this handler is not inherited by child processes."""


def interrupted() -> bool:
    """Whether a signal interrupted this process within the last `AGAIN_S` seconds."""
    return _first_s is not None and time.monotonic() - _first_s < AGAIN_S


def press_ctrl_c() -> None:
    """Interrupt this process as Ctrl-C does, even right after another signal."""
    global _first_s  # noqa: PLW0603
    _first_s = None
    os.kill(os.getpid(), signal.SIGINT)


@contextmanager
def ending_signals_interrupt(*, for_good: bool = False) -> Iterator[None]:
    """Context in which SIGINT, SIGTERM and SIGHUP raise KeyboardInterrupt; contexts may be nested.

    `for_good`: the process ends after the context; further signals are ignored, since they would change its exit code.
    """
    global _first_s  # noqa: PLW0603
    before = {number: signal.getsignal(number) for number in ENDING}
    if _interrupt in before.values() or threading.current_thread() is not threading.main_thread():
        yield
        return
    _first_s = None
    try:
        for number in ENDING:
            if number != signal.SIGHUP or before[number] != signal.SIG_IGN:  # set by nohup
                signal.signal(number, _interrupt)
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, signal.SIG_IGN if for_good else previous)


@contextmanager
def ending_signals_ignored() -> Iterator[None]:
    """Context in which `ENDING` signals are ignored, while the arm is stopped and the journal closed (under 1 s)."""
    before = {number: signal.getsignal(number) for number in ENDING}
    while any(signal.getsignal(number) is not _ignore for number in ENDING):
        with suppress(BaseException):  # a signal that came before its handler was replaced
            for number in ENDING:
                signal.signal(number, _ignore)
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


class ProcessEnd:
    """Ends this process with its exit code, even if other threads still run. Create it at the start."""

    def __init__(self) -> None:
        # The exit function registered first runs last.
        atexit.register(self._if_interrupted)
        self._code = 0

    def soon(self, code: int) -> None:
        """End the process with exit code `code` shortly after the main thread ends, even if other threads wait."""
        self._code = code
        threading.Thread(target=self._with_threads, daemon=True).start()

    def _with_threads(self) -> None:
        threading.main_thread().join()
        time.sleep(THREADS_S)
        os._exit(self._code)

    def _if_interrupted(self) -> None:
        """End an interrupted run with code 130. Otherwise, Python may end the run by SIGINT, as with ``python -c``."""
        if self._code == INTERRUPTED:
            for stream in (sys.stdout, sys.stderr):
                with suppress(OSError, ValueError):
                    stream.flush()
            os._exit(self._code)
