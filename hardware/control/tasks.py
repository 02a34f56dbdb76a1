"""Steps that the control loop runs for a caller in another thread, and their result."""

from __future__ import annotations

from collections.abc import Generator
from concurrent.futures import Future, wait
from dataclasses import dataclass, field
from threading import Thread
from typing import Any, Generic, TypeVar

from hardware.canopen.cyclic import Sample, Setpoints
from hardware.errors import HardwareError

Result = TypeVar("Result")
Steps = Generator[Setpoints | None, Sample, Result]
"""Generator that yields commands for the next SYNC (None: unchanged), receives its sample, and returns a result."""

_ALIVE_POLL_S = 0.2
"""How often a waiting caller checks that the loop's thread is alive."""


@dataclass(slots=True)
class LoopTask(Generic[Result]):
    """Steps to run; `despite`: alarms to ignore; `abandoned`: whether the caller was interrupted.

    `outcome` is the result of the steps, or the error that ended them.
    """

    steps: Steps[Result]
    despite: tuple[type[HardwareError], ...] = ()
    abandoned: bool = False
    outcome: Future[Result] = field(default_factory=Future)
    _started: bool = False

    def advance(self, sample: Sample) -> Setpoints | None:
        """Run the steps up to the next SYNC and return the commands; raises `StopIteration` when the steps end."""
        if self._started:
            return self.steps.send(sample)
        self._started = True
        return next(self.steps)

    def finish(self, *, result: Any = None, error: BaseException | None = None) -> None:
        """Pass the result or error to the caller."""
        self.steps.close()
        if error is None:
            self.outcome.set_result(result)
        else:
            self.outcome.set_exception(error)

    def wait(self, loop: Thread) -> bool:
        """Wait until `finish` was called; return false if the thread `loop` ended without calling it."""
        while not wait([self.outcome], _ALIVE_POLL_S).done:
            if not loop.is_alive():
                return self.outcome.done()
        return True
