"""What a session notices by itself while it takes poses: a stuck sensor, a jump, an arm that cannot start to move."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from hardware.arm import ArmSnapshot, MoveResult, Reading, Watch
from hardware.errors import DriveDiverged, SensorFault
from operator_app.cli import main
from operator_app.errors import Cancelled, GuardError, SessionError
from operator_app.session.store.journal import read_journal
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.opening import Choices, begin
from operator_app.session.workflow.session import Session
from tests.oracles.opened import MakeSession, opened
from tests.oracles.plant_arm import PlantArm
from tests.oracles.short_procedure import short_procedure


class Faulty(PlantArm):
    """The plant with a sensor that freezes, or a jump that is reported as the hardware reports it."""

    frozen: int = 0
    jumps_at_capture: int = 0
    captures = 0
    overloaded = False
    _stuck_at: float | None = None

    def capture(self, samples: int) -> Reading:
        self.captures += 1
        if self.captures == self.jumps_at_capture:
            raise SensorFault(3, "jumped by +500 counts", since_sync=self._syncs)
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
        if not self.overloaded:
            return found
        torques = (replace(j, torque_nm=95.0 if j.joint == 2 else 0.0) for j in found.joints)
        return replace(found, joints=tuple(torques))

    def move(
        self,
        targets_rad: Mapping[int, float],
        *,
        speed_rad_per_s: float,
        watch: Watch | None = None,
    ) -> MoveResult:
        if self.overloaded:
            return MoveResult(
                reached=False,
                reason="joint 2 needed 95 N m",
                positions_rad=self._positions(),
                syncs=3,
            )
        return super().move(targets_rad, speed_rad_per_s=speed_rad_per_s, watch=watch)


@pytest.fixture
def begun(tmp_path: Path) -> MakeSession:
    def make(name: str = "datasheet", poses: int = 8) -> Session:
        procedure = short_procedure(poses, name)
        session = opened(tmp_path / "s", Faulty(procedure, name), procedure)
        session.connect()
        return session

    return make


@pytest.mark.parametrize(("name", "joint"), [("datasheet", 3), ("datasheet", 6), ("exact", 7)])
def test_a_sensor_that_stands_still_is_named_and_its_pose_does_not_count(
    begun: MakeSession, name: str, joint: int
) -> None:
    session = begun(name)
    session.arm.frozen = joint
    with pytest.raises(
        SensorFault, match=rf"joint {joint} reads the same count as at pose \d+"
    ) as told:
        take_poses(session, Listener(), (1, 5))
    assert told.value.joint == joint
    assert "--unsensed" in str(told.value)
    assert len(session.state.poses) <= 3
    # It may have stood still before the last one as well.
    assert "read wrong at that time" in session.state.poses[-1].excluded
    names = [e.name for e in read_journal(session.journal.path.parent).events]
    assert "sensor_fault" in names


def test_a_sound_arm_is_never_called_stuck(begun: MakeSession) -> None:
    session = begun("exact", 6)
    take_poses(session, Listener(), (1, 5))
    assert len(session.state.used_poses) == 6


def test_after_a_jump_no_pose_counts_before_the_first_one_reads_as_it_did(
    begun: MakeSession,
) -> None:
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
    session.cancelled = lambda: len(session.state.poses) == taken + 1
    with pytest.raises(Cancelled):
        take_poses(session, Listener())
    assert not session.state.sensor_jump
    assert session.state.repeats[-1].first.number == 1


def test_a_pose_that_was_read_while_it_jumped_does_not_count(begun: MakeSession) -> None:
    session = begun()
    session.set_modes((1, 5))
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


def test_an_arm_that_cannot_begin_to_move_passes_no_waypoint_over(begun: MakeSession) -> None:
    session = begun()
    session.set_modes((1, 5))
    session.arm.overloaded = True
    with pytest.raises(GuardError, match=r"cannot start to move: joint 2 needed 95 N m"):
        take_poses(session, Listener())
    assert session.state.visited == frozenset()
    session.arm.overloaded = False
    session.cancelled = lambda: len(session.state.poses) == 2
    with pytest.raises(Cancelled):
        take_poses(session, Listener())
    assert {p.waypoint for p in session.state.poses} == {0, 1}


def test_what_was_passed_over_is_tried_again_when_resumed(
    begun: MakeSession, tmp_path: Path
) -> None:
    session = begun()
    session.set_modes((1, 5))
    session.record("waypoint_skipped", {"waypoint": 0, "reason": "joint 2 needed 95 N m"})
    assert session.state.next_waypoint == 1
    session.close("left")
    again = opened(
        tmp_path / "s", Faulty(session.procedure, "datasheet"), session.procedure, resumed=True
    )
    assert again.state.next_waypoint == 0
    again.close("done")


def test_a_speed_that_never_arrives_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = """schema: sarcal/procedure/1
name: slow
arm: sarcos_dextrous
fixture: hinge
bus: {interface: virtual}
modes: {position: [1, 5]}
capture:
  poses: 4
  speed_deg_per_s: 1.0e-300
  settle: {window_syncs: 10, timeout_syncs: 300}
  samples_per_pose: 4
"""
    (tmp_path / "slow.yaml").write_text(text)
    code = main(["run", str(tmp_path / "slow.yaml"), "--sessions", str(tmp_path / "s")])
    said = capsys.readouterr().err
    assert code == 2
    assert "speed_deg_per_s" in said
    assert "Traceback" not in said


@pytest.mark.parametrize("poses", [10**6, 10**30])
def test_poses_beyond_all_reason_are_refused(tmp_path: Path, poses: int) -> None:
    with pytest.raises(SessionError, match="at most 100000"):
        begin("hinge", Choices(poses=poses), root=tmp_path)


class LinearityDeviation(PlantArm):
    """The plant, stopped by itself while nobody asked anything of it."""

    why: SensorFault | None = None

    def snapshot(self) -> ArmSnapshot:
        return replace(super().snapshot(), stopped_for="" if self.why is None else str(self.why))

    def capture(self, samples: int) -> Reading:
        if self.why is not None:
            raise self.why
        return super().capture(samples)


def stray(folder: Path) -> tuple[LinearityDeviation, Session]:
    """Begin a session on it, its drives in place."""
    procedure = short_procedure(8, "datasheet")
    arm = LinearityDeviation(procedure, "datasheet")
    session = opened(folder, arm, procedure)
    session.connect()
    session.set_modes((1, 5))
    return arm, session


def test_why_an_arm_was_stopped_by_itself_is_kept_once_and_the_pose_read_then_does_not_count(
    tmp_path: Path,
) -> None:
    arm, session = stray(tmp_path / "s")
    session.record_stop_cause()
    session.capture()
    arm.why = DriveDiverged(5, 1300, since_sync=arm.snapshot().sync_count - 3)
    for ask in (session.record_stop_cause, session.record_stop_cause, session.read):
        with pytest.raises(DriveDiverged):
            ask()
    events = read_journal(tmp_path / "s").events
    (kept,) = [e.data for e in events if e.name == "sensor_fault"]
    assert kept == {"joint": 5, "text": str(arm.why)}
    assert "joint 5 read wrong at that time" in session.state.poses[0].excluded
    assert session.state.sensor_jump


@pytest.mark.parametrize(
    "forgets",
    [
        lambda session: session.reset_stop(),
        lambda session: session.let_go(),
        lambda session: session.close("left"),
    ],
    ids=["reset", "connect anew", "close"],
)
def test_why_an_arm_was_stopped_is_kept_before_the_arm_forgets_it(
    tmp_path: Path, forgets: Callable[[Session], object]
) -> None:
    """Whoever presses the key is quicker than the watchman."""
    arm, session = stray(tmp_path / "s")
    session.capture()
    arm.why = DriveDiverged(5, 1300, since_sync=arm.snapshot().sync_count - 3)
    forgets(session)
    kept = [
        e.data["joint"] for e in read_journal(tmp_path / "s").events if e.name == "sensor_fault"
    ]
    assert kept == [5]
    assert session.state.sensor_jump
    assert session.state.used_poses == ()
