"""Passes steps from the caller's thread to the control loop, and results back; handles Ctrl-C in the meantime."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator
from concurrent.futures import Future, wait
from dataclasses import dataclass, field
from typing import Any

from hardware.canopen.cyclic import Sample, Setpoints
from hardware.errors import HardwareError

Steps = Generator[Setpoints | None, Sample, Any]
"""Generator that yields commands for the next SYNC (None: unchanged), receives its sample, and returns a result."""

_ALIVE_POLL_S = 0.2
"""How often a waiting caller checks that the loop's thread is alive."""


@dataclass(slots=True)
class LoopTask:
    """Steps to run; `despite`: alarms to ignore; `abandoned`: whether the caller was interrupted.

    `outcome` is the result of the steps, or the error that ended them.
    """

    steps: Steps
    despite: tuple[type[HardwareError], ...] = ()
    abandoned: bool = False
    outcome: Future[Any] = field(default_factory=Future)
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

    def wait(self, loop_alive: Callable[[], bool]) -> bool:
        """Wait until `finish` was called; return false if the loop ended without calling it."""
        while not wait([self.outcome], _ALIVE_POLL_S).done:
            if not loop_alive():
                return self.outcome.done()
        return True


class TaskQueue:
    """Tasks in the order in which they were requested; the control loop works on the first.

    `closed_error` returns the error to raise after the loop has ended.
    """

    def __init__(
        self, loop_alive: Callable[[], bool], closed_error: Callable[[], HardwareError]
    ) -> None:
        self._loop_alive, self._closed_error = loop_alive, closed_error
        self._tasks: deque[LoopTask] = deque()

    def run(self, task: LoopTask) -> Any:
        """Run a task and return its result; may be called from any thread but the loop's.

        An interrupt (Ctrl-C) is raised after the steps have brought the arm to rest.
        """
        try:
            self._tasks.append(task)
            answered = task.wait(self._loop_alive)
        except BaseException:
            task.abandoned = True
            task.wait(self._loop_alive)
            raise
        if not answered:
            raise self._closed_error()
        return task.outcome.result()

    @property
    def first(self) -> LoopTask | None:
        """The task to work on; None if there is none."""
        return self._tasks[0] if self._tasks else None

    def finish_first(self, *, result: Any = None, error: BaseException | None = None) -> None:
        """Remove the first task and pass its result or error to its caller."""
        self._tasks.popleft().finish(result=result, error=error)

    def finish_all(self, error: HardwareError) -> None:
        """End all tasks with the same error."""
        while self._tasks:
            self.finish_first(error=error)
