"""A listener that records reports, and captures that end after a number of poses."""

from collections.abc import Callable
from pathlib import Path

import pytest

from hardware.arm import ArmInterface
from operator_app.config.procedure import Procedure
from operator_app.errors import Cancelled
from operator_app.session.store.state import SessionState
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from tests.oracles.opened import opened


class RecordingListener(Listener):
    """`said` are the reports, `heard` the numbers of used poses; `then` is called with the number of all poses."""

    def __init__(self, then: Callable[[int], object] = id) -> None:
        self.said: list[str] = []
        self.heard: list[int] = []
        self._then = then

    def report(self, text: str) -> None:
        self.said.append(text)

    def pose_captured(self, state: SessionState, total: int) -> None:
        self.heard.append(len(state.used_poses))
        self._then(len(state.poses))


def take_poses_until(session: Session, poses: int) -> None:
    """Take poses with joints 1 and 5 as drives; the operator cancels after `poses`."""
    session.cancelled = lambda: len(session.state.poses) == poses
    with pytest.raises(Cancelled):
        take_poses(session, Listener(), (1, 5))


def left_session(folder: Path, arm: ArmInterface, procedure: Procedure, poses: int) -> Path:
    """The folder of a session that was left after `poses` poses."""
    session = opened(folder, arm, procedure)
    session.connect()
    if poses:
        take_poses_until(session, poses)
    session.close("left")
    return folder
