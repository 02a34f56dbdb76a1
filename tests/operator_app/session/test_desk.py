"""The desk's promises to a screen: what it shows of work in hand, and that nothing waits."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from operator_app.session.desk import Desk
from operator_app.session.snapshot import TaskKind
from oracles.live_source import FakeSource

PATIENCE_S = 30.0


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    source = FakeSource(tmp_path / "sessions")
    yield source.new()
    source.close("end of the test")


class Eager(queue.SimpleQueue):
    """Returns from handing work over when it is done: no worker can be quicker."""

    def __init__(self) -> None:
        self._waits = threading.Semaphore(0)

    def get(self, *_: object) -> object:
        self._waits.release()
        return super().get()

    def put(self, item: object, *_: object) -> None:
        if item is not None:
            assert self._waits.acquire(timeout=PATIENCE_S)
        super().put(item)
        if item is not None:
            assert self._waits.acquire(timeout=PATIENCE_S)
            self._waits.release()


def finish(desk: Desk) -> None:
    """Wait until the worker has done everything that was handed in before."""
    done = threading.Event()
    desk.submit(TaskKind.NOTE, "the last", done.set)
    assert done.wait(PATIENCE_S)
    for _ in range(10_000):
        if not desk._hand:
            return
        threading.Event().wait(0.001)


def test_work_that_is_over_at_once_is_not_shown_for_ever(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("operator_app.session.desk.queue", SimpleNamespace(SimpleQueue=Eager))
    source = FakeSource(tmp_path / "sessions")
    desk = source.new()
    ran: list[int] = []
    for k in range(3):
        desk.submit(TaskKind.CONNECT, f"job {k}", lambda k=k: ran.append(k))
        assert desk.snapshot().task is None
    assert ran == [0, 1, 2]
    source.close("end of the test")


def test_work_is_shown_before_it_begins_and_while_it_lasts(desk: Desk) -> None:
    begun, go_on = threading.Event(), threading.Event()

    def work() -> None:
        begun.set()
        go_on.wait(PATIENCE_S)

    desk.submit(TaskKind.CALIBRATE, "the first", work)
    assert begun.wait(PATIENCE_S)
    desk.submit(TaskKind.NOTE, "the second", lambda: None)
    task = desk.snapshot().task
    assert task is not None
    assert (task.kind, task.text) == (TaskKind.CALIBRATE, "the first")
    go_on.set()
    finish(desk)
    assert desk.snapshot().task is None


def test_what_waits_behind_cancelled_work_never_begins(desk: Desk) -> None:
    begun, go_on = threading.Event(), threading.Event()
    ran: list[str] = []

    def work() -> None:
        begun.set()
        go_on.wait(PATIENCE_S)

    desk.submit(TaskKind.AUTOMATIC, "the first", work)
    desk.submit(TaskKind.MOVE, "the second", lambda: ran.append("second"))
    assert begun.wait(PATIENCE_S)
    desk.cancel()
    go_on.set()
    finish(desk)
    assert not ran
    assert any("the second: ended by the operator" in m.text for m in desk.snapshot().messages)
