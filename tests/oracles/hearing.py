"""A listener that keeps what it hears, and captures that end after so many poses."""

from collections.abc import Callable

import pytest

from operator_app.errors import Cancelled
from operator_app.session.store.state import SessionState
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session


class Hearing(Listener):
    """`said` is what was reported, `heard` how many poses counted; `then` is called with how many there are."""

    def __init__(self, then: Callable[[int], object] = id) -> None:
        self.said: list[str] = []
        self.heard: list[int] = []
        self._then = then

    def report(self, text: str) -> None:
        self.said.append(text)

    def pose_captured(self, state: SessionState, total: int) -> None:
        self.heard.append(len(state.used_poses))
        self._then(len(state.poses))


def take_until(
    session: Session, poses: int, listener: Listener | None = None, *, homing: bool = False
) -> None:
    """Take poses with joints 1 and 5 driving; the operator ends it when there are so many."""
    session.cancelled = lambda: len(session.state.poses) == poses
    with pytest.raises(Cancelled):
        take_poses(session, listener or Listener(), (1, 5), homing=homing)
