"""Steps that the control loop runs for a caller in another thread, and their result.

The loop takes no lock that Ctrl-C in the caller's thread can leave locked: conditions and futures have such locks;
`TimedQueue`, based on a queue in C, has none. `Thread.is_alive` is not used either: up to Python 3.12, Ctrl-C during a
call can make all later calls return false.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import suppress
from dataclasses import dataclass, field
from queue import Empty
from typing import Any, TypeVar

from hardware.canopen.cyclic import Sample, Setpoints
from hardware.errors import HardwareError
from hardware.timed_queue import TimedQueue

Result = TypeVar("Result")
Steps = Generator[Setpoints | None, Sample, Result]
"""Generator that yields commands for the next SYNC, or None to repeat the last commands; receives the sample of that
SYNC; and returns a result."""

_ALIVE_POLL_S = 0.2
"""Period at which a waiting caller checks that the loop runs."""


@dataclass(slots=True, eq=False)
class LoopTask:
    """Steps to run; `despite`: alarms to ignore; `abandoned`: whether the caller was interrupted.

    When `finished`, the steps have ended with a `result`, or with an `error`.
    """

    steps: Steps[Any]
    despite: tuple[type[HardwareError], ...] = ()
    abandoned: bool = False
    finished: bool = False
    result: Any = None
    error: BaseException | None = None
    _started: bool = False
    _wake: TimedQueue[None] = field(default_factory=TimedQueue)

    def advance(self, sample: Sample) -> Setpoints | None:
        """Run the steps up to the next SYNC and return the commands; raises `StopIteration` when the steps end."""
        if self._started:
            return self.steps.send(sample)
        self._started = True
        return next(self.steps)

    def finish(self, *, result: Any = None, error: BaseException | None = None) -> None:
        """Pass the result or error to the caller."""
        self.steps.close()
        self.result, self.error = result, error
        self.finished = True
        self._wake.put(None)

    def wait(self, may_finish: Callable[[], bool]) -> bool:
        """Wait until `finish` was called; return false if `may_finish` returns false before that."""
        while not self.finished:
            with suppress(Empty):
                self._wake.get(timeout=_ALIVE_POLL_S)
            if not may_finish():
                break
        return self.finished
