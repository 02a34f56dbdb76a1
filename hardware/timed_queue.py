"""A queue between threads; a wait ends at its time-out, even on a busy computer."""

from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import TypeVar

Item = TypeVar("Item")


class TimedQueue(SimpleQueue[Item]):
    """`queue.SimpleQueue` for one reader, with a time-out that always ends the wait.

    After a `put`, the lock of the queue is free. Up to Python 3.12, the next wait acquires the lock, then computes the
    time left. If the thread was off the processor for longer than the time-out, the time left is negative, and the wait
    does not end. `get` therefore first tries without waiting: this attempt already acquires the lock.
    """

    def get(self, block: bool = True, timeout: float | None = None) -> Item:  # noqa: FBT001, FBT002
        """Return the next item; raises `queue.Empty` if there is none within `timeout` seconds."""
        if block and timeout is not None:
            with suppress(Empty):
                return super().get(block=False)
        return super().get(block, timeout)
