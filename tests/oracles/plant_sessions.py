"""Sessions of a test's own arm: short procedures, reproducible times, a listener, captures of a few poses."""

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from hardware.arm import ArmInterface
from hardware.virtual.scenarios import scenario
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import Cancelled
from operator_app.session.store.journal import Clock, utc_now
from operator_app.session.store.state import SessionState
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.opening import Choices, Opening, Rig, open_session
from operator_app.session.workflow.session import Session

MakeSession = Callable[..., Session]
"""Type of the fixture `make_session`."""


class TickingClock:
    """Reproducible time of day for journals."""

    def __init__(self) -> None:
        self._now = datetime(2026, 1, 31, 12, 0, 0, tzinfo=UTC)

    def __call__(self) -> datetime:
        self._now += timedelta(seconds=1)
        return self._now


def short_procedure(
    poses: int, name: str = "exact", *, packaged: str = "hinge", seed: int = 0, samples: int = 8
) -> Procedure:
    """A packaged procedure with `poses` poses of `samples` samples, for the arm of scenario `name`."""
    procedure = load_procedure(packaged)
    return replace(
        procedure,
        arm=scenario(name, seed).arm(procedure.arm),
        capture=replace(procedure.capture, poses=poses, samples_per_pose=samples),
    )


def opened(
    folder: Path,
    arm: ArmInterface,
    procedure: Procedure,
    *,
    resumed: bool = False,
    clock: Clock = utc_now,
) -> Session:
    opening = Opening(folder=folder, resumed=resumed, procedure=procedure, choices=Choices())
    return open_session(Rig(arm=arm, opening=opening, simulated=True), clock=clock)


class RecordingListener(Listener):
    """`reports` are texts, `counts` the numbers of used poses; `then` is called with the number of all poses."""

    def __init__(self, then: Callable[[int], object] = id) -> None:
        self.reports: list[str] = []
        self.counts: list[int] = []
        self._then = then

    def report(self, text: str) -> None:
        self.reports.append(text)

    def pose_captured(self, state: SessionState, total: int) -> None:
        self.counts.append(len(state.used_poses))
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
