"""Waits of `TimedQueue` end at their time-out while other threads use the processor."""

import sys
import threading
from contextlib import suppress
from queue import Empty

import pytest

from hardware.timed_queue import TimedQueue

TIMEOUT_S = 1e-5
"""Shorter than the time for which other threads have the processor."""


@pytest.fixture
def busy_threads():
    before, over = sys.getswitchinterval(), threading.Event()
    sys.setswitchinterval(1e-6)

    def use_processor():
        while not over.is_set():
            pass

    threads = [threading.Thread(target=use_processor) for _ in range(2)]
    for thread in threads:
        thread.start()
    yield
    sys.setswitchinterval(before)
    over.set()
    for thread in threads:
        thread.join()


def test_wait_ends_though_its_thread_was_off_the_processor_for_longer(busy_threads):
    """`queue.SimpleQueue` of Python 3.11 does not return within some 2,000 attempts."""

    def wait_often():
        for _ in range(4_000):
            queue: TimedQueue[int] = TimedQueue()
            for _ in range(2):  # the put frees the lock again
                with suppress(Empty):
                    queue.get(timeout=TIMEOUT_S)
                queue.put(1)
                assert queue.get(timeout=TIMEOUT_S) == 1

    waiting = threading.Thread(target=wait_often, daemon=True)
    waiting.start()
    waiting.join(60.0)
    assert not waiting.is_alive()


def test_item_is_returned_at_once():
    queue: TimedQueue[int] = TimedQueue()
    queue.put(7)
    assert queue.get(timeout=100.0) == 7
    with pytest.raises(Empty):
        queue.get_nowait()
