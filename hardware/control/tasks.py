"""Hands commands from the caller's thread to the control loop's and back, Ctrl-C included. Knows no bus."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from typing import Any

from hardware.canopen.cyclic import Sample, Setpoints
from hardware.errors import HardwareError

Steps = Generator[Setpoints | None, Sample, Any]
"""Yields commands for the next SYNC (None: as before), is sent its sample, returns its result."""

_LOOK_S = 0.2
"""How often a waiting caller makes sure that somebody is still there to answer."""


@dataclass(slots=True)
class LoopTask:
    """Steps on their way through the control loop.

    Attributes
    ----------
    despite
        Alarms that do not end these steps.
    abandoned
        The caller was interrupted: come to rest and end.
    """

    steps: Steps
    despite: tuple[type[HardwareError], ...] = ()
    abandoned: bool = False
    _started: bool = False
    _done: threading.Event = field(default_factory=threading.Event)
    _result: Any = None
    _error: BaseException | None = None

    def advance(self, sample: Sample) -> Setpoints | None:
        """Run the steps to their next SYNC; StopIteration at their end."""
        if self._started:
            return self.steps.send(sample)
        self._started = True
        return next(self.steps)

    def finish(self, *, result: Any = None, error: BaseException | None = None) -> None:
        """Tell the caller how it ended."""
        self.steps.close()
        self._result, self._error = result, error
        self._done.set()

    def wait(self, someone_there: Callable[[], bool]) -> bool:
        """Wait for `finish`; false if nobody is there to call it."""
        while not self._done.wait(_LOOK_S):
            if not someone_there():
                return self._done.is_set()
        return True

    def outcome(self) -> Any:
        """Return the result, or raise what ended the steps."""
        if self._error is not None:
            raise self._error
        return self._result


class TaskQueue:
    """Tasks in the order they were asked for; the loop works on the first one.

    Parameters
    ----------
    someone_there
        Whether the loop's thread is alive.
    gone
        What to raise when it is not.
    """

    def __init__(
        self, someone_there: Callable[[], bool], gone: Callable[[], HardwareError]
    ) -> None:
        self._someone_there, self._gone = someone_there, gone
        self._tasks: deque[LoopTask] = deque()

    def run(self, task: LoopTask) -> Any:
        """Have a task run and return its result; for every thread but the loop's.

        An interrupt (Ctrl-C) is held back until the steps have brought the arm to rest.
        """
        try:
            self._tasks.append(task)
            answered = task.wait(self._someone_there)
        except BaseException:
            task.abandoned = True
            task.wait(self._someone_there)
            raise
        if not answered:
            raise self._gone()
        return task.outcome()

    @property
    def first(self) -> LoopTask | None:
        """The task to work on."""
        return self._tasks[0] if self._tasks else None

    def finish_first(self, *, result: Any = None, error: BaseException | None = None) -> None:
        """End the first task."""
        self._tasks.popleft().finish(result=result, error=error)

    def finish_all(self, error: HardwareError) -> None:
        """End all tasks with an error."""
        while self._tasks:
            self.finish_first(error=error)
