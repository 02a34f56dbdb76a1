"""What a session notices by itself while it takes poses: a stuck sensor, a jump, an arm that cannot start to move."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pytest

from hardware.arm import ArmSnapshot, MoveResult, Reading
from hardware.errors import DriveDiverged, SensorFault
from operator_app.errors import GuardError, SessionError
from operator_app.session.store.journal import read_journal
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.opening import Choices, begin
from operator_app.session.workflow.session import Session
from tests.oracles.hearing import take_until
from tests.oracles.plant_arm import PlantArm
from tests.oracles.short_procedure import short_procedure


class Faulty(PlantArm):
    """The plant with a sensor that freezes, a jump, or a stop by itself, reported as the hardware reports them."""

    frozen: int = 0
    jumps_at_capture: int = 0
    captures = 0
    overloaded = False
    stopped_by: SensorFault | None = None
    _stuck_at: float | None = None

    def capture(self, samples: int) -> Reading:
        self.captures += 1
        if self.captures == self.jumps_at_capture:
            raise SensorFault(3, "jumped by +500 counts", since_sync=self._syncs)
        if self.stopped_by is not None:
            raise self.stopped_by
        found = super().capture(samples)
        if self.frozen:
            at = self.frozen - 1
            if self._stuck_at is None:
                self._stuck_at = float(found.mean_rad[at])
            mean, sd = found.mean_rad.copy(), found.sd_rad.copy()
            mean[at], sd[at] = self._stuck_at, 0.0
            found = replace(found, mean_rad=mean, sd_rad=sd)
        return found

    def snapshot(self) -> ArmSnapshot:
        found = super().snapshot()
        why = "" if self.stopped_by is None else str(self.stopped_by)
        torques = (
            replace(j, torque_nm=95.0 if self.overloaded and j.joint == 2 else 0.0)
            for j in found.joints
        )
        return replace(found, joints=tuple(torques), stopped_for=why)

    def move(self, targets_rad: Mapping[int, float], **options: Any) -> MoveResult:
        if self.overloaded:
            why, here = "joint 2 needed 95 N m", self._positions()
            return MoveResult(reached=False, reason=why, positions_rad=here, syncs=3)
        return super().move(targets_rad, **options)


@pytest.fixture
def begun(make_session):
    def make(name: str = "datasheet", poses: int = 8) -> Session:
        procedure = short_procedure(poses, name)
        return make_session(procedure, arm=Faulty(procedure, name), connect=True)

    return make


@pytest.fixture
def session(begun):
    """With its drives in place."""
    made = begun()
    made.set_modes((1, 5))
    return made


def kept_faults(session: Session) -> list[Mapping[str, object]]:
    events = read_journal(session.journal.path.parent).events
    return [e.data for e in events if e.name == "sensor_fault"]


@pytest.mark.parametrize(("name", "joint"), [("datasheet", 3), ("datasheet", 6), ("exact", 7)])
def test_a_sensor_that_stands_still_is_named_and_its_pose_does_not_count(begun, name, joint):
    session = begun(name)
    session.arm.frozen = joint
    with pytest.raises(SensorFault, match=rf"joint {joint} reads the same count") as told:
        take_poses(session, Listener(), (1, 5))
    assert told.value.joint == joint
    assert "--unsensed" in str(told.value)
    assert len(session.state.poses) <= 3
    # It may have stood still before the last one as well.
    assert "read wrong at that time" in session.state.poses[-1].excluded
    assert [fault["joint"] for fault in kept_faults(session)] == [joint]


def test_after_a_jump_no_pose_counts_before_the_first_one_reads_as_it_did(begun):
    session = begun()
    arm = session.arm
    arm.jumps_at_capture = 5  # the first one is that of taking control
    with pytest.raises(SensorFault):
        take_poses(session, Listener(), (1, 5))
    taken = len(session.state.poses)
    assert session.state.sensor_jump
    with pytest.raises(GuardError, match="captures are refused: joint 3 jumped"):
        session.capture()
    assert len(session.state.poses) == taken

    # It reads as it did: whatever that was, it is over.
    take_until(session, taken + 1)
    assert not session.state.sensor_jump
    assert session.state.repeats[-1].first.number == 1


def test_a_pose_that_was_read_while_it_jumped_does_not_count(session):
    session.capture()
    assert len(session.state.used_poses) == 1
    until = session.arm.snapshot().sync_count

    def late(targets_rad: object, **_: object) -> MoveResult:
        raise SensorFault(4, "jumped", since_sync=until - 3)

    session.arm.move = late
    with pytest.raises(SensorFault):
        session.go_to({1: 0.0})
    assert session.state.used_poses == ()
    assert "joint 4 read wrong at that time" in session.state.poses[0].excluded


def test_an_arm_that_cannot_begin_to_move_passes_no_waypoint_over(session):
    session.arm.overloaded = True
    with pytest.raises(GuardError, match=r"cannot start to move: joint 2 needed 95 N m"):
        take_poses(session, Listener())
    assert session.state.visited == frozenset()
    session.arm.overloaded = False
    take_until(session, 2)
    assert {p.waypoint for p in session.state.poses} == {0, 1}


def test_what_was_passed_over_is_tried_again_when_resumed(session, make_session):
    session.record("waypoint_skipped", {"waypoint": 0, "reason": "joint 2 needed 95 N m"})
    assert session.state.next_waypoint == 1
    session.close("left")
    assert make_session(session.procedure, resume=True).state.next_waypoint == 0


@pytest.mark.parametrize("poses", [10**6, 10**30])
def test_poses_beyond_all_reason_are_refused(tmp_path, poses):
    with pytest.raises(SessionError, match="at most 100000"):
        begin("hinge", Choices(poses=poses), root=tmp_path)


def diverged(session: Session) -> DriveDiverged:
    """The arm stops by itself while nobody asked anything of it; a pose was read at that time."""
    session.capture()
    arm = session.arm
    arm.stopped_by = DriveDiverged(5, 1300, since_sync=arm.snapshot().sync_count - 3)
    return arm.stopped_by


def test_why_an_arm_was_stopped_by_itself_is_kept_once_and_the_pose_read_then_does_not_count(
    session,
):
    session.record_stop_cause()
    why = diverged(session)
    for ask in (session.record_stop_cause, session.record_stop_cause, session.read):
        with pytest.raises(DriveDiverged):
            ask()
    assert kept_faults(session) == [{"joint": 5, "text": str(why)}]
    assert "joint 5 read wrong at that time" in session.state.poses[0].excluded
    assert session.state.sensor_jump


@pytest.mark.parametrize(
    "forgets",
    [
        lambda session: session.reset_stop(),
        lambda session: session.release_holding(),
        lambda session: session.close("left"),
    ],
    ids=["reset", "connect anew", "close"],
)
def test_why_an_arm_was_stopped_is_kept_before_the_arm_forgets_it(session, forgets):
    """Whoever presses the key is quicker than the watchman."""
    diverged(session)
    forgets(session)
    assert [fault["joint"] for fault in kept_faults(session)] == [5]
    assert session.state.sensor_jump
    assert session.state.used_poses == ()
