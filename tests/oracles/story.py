"""Reproducible snapshots of one calibration session, after each of its steps."""

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from hardware.arm import ArmSnapshot, DriveState, JointState
from hardware.errors import DriveDiverged
from operator_app.config.procedure_file import load_procedure
from operator_app.messages.errors import stopped_words
from operator_app.messages.finding import Finding, FindingKind
from operator_app.session.ui.runner import Runner
from operator_app.session.ui.snapshot import (
    ARM_RECOVERY,
    DataState,
    Level,
    RunningTask,
    SessionSnapshot,
    StopReport,
    TaskKind,
)
from operator_app.session.ui.supervisor import Motion
from tests.oracles.live_arm import LiveArm
from tests.oracles.plant_sessions import TickingClock, opened
from tests.oracles.recorded import recorded

POSES = 16
NOW_S = 1000.0
MOTION_AT_REST = Motion(
    sync_rate_hz=100.0,
    speed_rad_per_s=np.zeros(7),
    still=True,
    held_s=1.4,
    needed_s=0.52,
    worst_joint=6,
    spread_share=0.31,
)
FOLDER = Path("sessions/20260131-120000-hinge")


class StaticArm(LiveArm):
    """An arm without a SYNC thread; its snapshots are always fresh."""

    def _run_syncs(self) -> None:
        """Do nothing."""

    def snapshot(self) -> ArmSnapshot:
        self._stamp = time.monotonic()
        return super().snapshot()


@cache
@recorded
def story() -> Mapping[str, SessionSnapshot]:
    """Snapshots by the last step."""
    pictures: dict[str, SessionSnapshot] = {}
    procedure = load_procedure("hinge")
    procedure = replace(procedure, capture=replace(procedure.capture, poses=POSES))
    clock = TickingClock()
    with TemporaryDirectory() as root:
        arm = StaticArm(procedure, "datasheet")
        session = opened(Path(root) / "session", arm, procedure, clock=clock)
        runner = Runner(session, monotonic=lambda: NOW_S, clock=clock)

        def record(name: str) -> None:
            pictures[name] = _reproducible(runner.snapshot())

        try:
            record("start")
            runner.operations.connect()
            record("connected")
            ticked = frozenset(range(len(procedure.fixture.checklist)))
            runner.publish(lambda s: replace(s, ticked=ticked))
            record("ticked")
            runner.operations.set_modes((1, 5))
            record("modes")
            for _ in range(3):
                runner.operations.go(session.state.next_waypoint)
                runner.operations.capture(session.state.next_waypoint)
            runner.operations.note(2, "cable touched?")
            record("capturing")
            runner.operations.automatic()
            runner.operations.exclude(3)
            runner.operations.automatic()
            record("captured")
            runner.operations.calibrate("implicit", ())
            record("solved")
            runner.operations.write()
            record("written")
            runner.operations.verify(3)
            record("verified")
            runner.operations.write(upload=True)
            record("uploaded")
        finally:
            runner.close("done")
    return pictures


def _reproducible(s: SessionSnapshot) -> SessionSnapshot:
    """Replace values that depend on the clock and the machine."""
    arm, written = s.arm, s.written
    if arm is not None:
        arm = replace(
            arm,
            joints=tuple(replace(j, age_s=0.004) for j in arm.joints),
            heartbeat_age_s=dict.fromkeys(arm.heartbeat_age_s, 0.020),
        )
    if written is not None:
        written = replace(written, parameters=FOLDER / "parameters.yaml", sha256="9f3c" * 16)
    messages = tuple(
        replace(m, text=m.text.replace(str(s.folder), str(FOLDER))) for m in s.messages
    )
    return replace(
        s,
        arm=arm,
        folder=FOLDER,
        written=written,
        messages=messages,
        data=DataState.NONE if arm is None else DataState.FRESH,
        oldest_s=0.0 if arm is None else 0.004,
        stale_joints=(),
        motion=None if arm is None else MOTION_AT_REST,
    )


def with_joints(
    s: SessionSnapshot, change: Callable[[JointState], JointState], **changes: Any
) -> SessionSnapshot:
    """The snapshot with changed joints and other changes."""
    assert s.arm is not None
    return replace(s, arm=replace(s.arm, joints=tuple(map(change, s.arm.joints))), **changes)


def _aged(
    s: SessionSnapshot, data: DataState, age_s: float, joints: tuple[int, ...]
) -> SessionSnapshot:
    """The snapshot with data of this age of some joints."""
    return with_joints(
        s,
        lambda j: replace(j, age_s=age_s) if j.joint in joints else j,
        data=data,
        motion=None,
        oldest_s=age_s,
        stale_joints=joints,
    )


def stale(s: SessionSnapshot) -> SessionSnapshot:
    return _aged(s, DataState.STALE, 0.24, (5,))


def lost(s: SessionSnapshot) -> SessionSnapshot:
    return _aged(s, DataState.LOST, 1.5, tuple(range(1, 8)))


def stopped(s: SessionSnapshot) -> SessionSnapshot:
    report = StopReport(asked_s=NOW_S, acknowledged_after_s=0.012, drives_stopped=7)
    quick_stop = {"drive": DriveState.QUICK_STOP_ACTIVE, "mode": None}
    s = with_joints(s, lambda j: replace(j, **quick_stop), stop=report, task=None)
    assert s.arm is not None
    return replace(s, arm=replace(s.arm, stopped=True))


def unstopped(s: SessionSnapshot) -> SessionSnapshot:
    """The drives of joints 3 and 5 do not obey STOP."""
    s, joints = stopped(s), (3, 5)
    return with_joints(
        s,
        lambda j: replace(j, drive=DriveState.OPERATION_ENABLED) if j.joint in joints else j,
        stop=StopReport(asked_s=NOW_S - 0.6, drives_stopped=5),
        unstopped_joints=joints,
    )


def diverged(s: SessionSnapshot) -> SessionSnapshot:
    """The arm stopped because a joint differs from its target."""
    stopped_snapshot = stopped(s)
    assert stopped_snapshot.arm is not None
    reason = str(DriveDiverged(5, 1294, 700))
    s = replace(stopped_snapshot, stop=None, arm=replace(stopped_snapshot.arm, stopped_for=reason))
    return s.with_message(
        Level.ALARM, stopped_words(reason), time="12:07:41", resolving_tasks=ARM_RECOVERY
    )


def tripped(s: SessionSnapshot) -> SessionSnapshot:
    fault = {"drive": DriveState.FAULT, "mode": None}
    return with_joints(s, lambda j: replace(j, **fault) if j.joint == 4 else j)


def busy(s: SessionSnapshot, kind: TaskKind, *, moves: bool) -> SessionSnapshot:
    return replace(s, task=RunningTask(kind=kind, text=kind.value, moves=moves, started_s=NOW_S))


def real(s: SessionSnapshot) -> SessionSnapshot:
    """The same on a real arm, nothing confirmed yet."""
    return replace(s, simulated=False, bus="socketcan can0 1000000 bit/s", ticked=frozenset())


def with_condition_above(s: SessionSnapshot, limit: float) -> SessionSnapshot:
    """With the note that the condition number of the calibration exceeds this limit."""
    assert s.solution is not None
    number = s.solution.identifiability.scaled_condition_number
    note = Finding(FindingKind.CONDITION, names=("a_0",), size=number, figures={"limit": limit})
    return replace(s, solution=replace(s.solution, warnings=(note, *s.solution.warnings)))
