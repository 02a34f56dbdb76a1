"""The bench check: stages, consent, findings, and the state in which it leaves the arm."""

import math
import os
import signal
import time
from contextlib import closing, nullcontext
from dataclasses import replace
from functools import partial
from typing import Any

import can
import pytest
from can.interfaces.virtual import VirtualBus

from hardware.arm import ArmSnapshot, DriveState, MoveResult
from hardware.arm_description import EncoderDescription, RvdtDescription
from hardware.buses.python_can import BusSettings
from hardware.canopen.objects import COB_HEARTBEAT, HEARTBEAT_CONSUMER, OPERATOR_NODE
from hardware.commissioning import checks
from hardware.commissioning.bench_check import NOT_TESTED, Bench, CheckFinding, Stage, check
from hardware.commissioning.checks import Turn, is_interrupted
from hardware.commissioning.clauses import BENCH
from hardware.control.canopen_arm import CanopenArm
from hardware.timing import Pace
from tests.hardware.conftest import JOINTS, drafted, unconnected
from tests.oracles.descriptions import described
from tests.oracles.profiles import sarcos
from tests.oracles.virtual_rig import ARM, COUNTS_PER_REV, Rig, rig

HEARTBEAT_TIMEOUT_S = 1.5
STEP, SPEED = math.radians(1.0), math.radians(5.0)
STILL_ENABLED = "is still enabled 0.5 s after STOP"


class User:
    """Answers yes, except to questions with one of the refused phrases."""

    def __init__(self, *refused: str) -> None:
        self.refused, self.questions = refused, list[str]()

    def __call__(self, question: str) -> bool:
        self.questions.append(question)
        return not any(phrase in question for phrase in self.refused)


running_bench = partial(rig, clock=time.monotonic, heartbeat_timeout_s=HEARTBEAT_TIMEOUT_S)
"""Our own drives, each joint of which moves by itself."""


@pytest.fixture
def bench():
    with running_bench() as bench:
        yield bench


def arm_of(bench: Rig, **options: Any) -> CanopenArm:
    rvdt = RvdtDescription(bits=12, full_scale_rad=math.radians(144.0))
    encoder = EncoderDescription(counts_per_rev=COUNTS_PER_REV)
    description = described(
        ARM.model,
        *((sensor, math.radians(60.0)) for sensor in [encoder] * 5 + [rvdt] * 2),
        max_speed_rad_per_s=math.radians(180.0),
        max_torque_nm=100.0,
    )
    return unconnected(BusSettings(channel=bench.channel), sarcos(), description, **options)


def findings_of(
    arm: CanopenArm, user: User, last: Stage = Stage.SILENCE, **options: Any
) -> list[CheckFinding]:
    settings = {
        "description": arm.on_bus.description,
        "interrupt": lambda: os.kill(os.getpid(), signal.SIGINT),
        "bounds": replace(BENCH, samples=10),
    }
    bench = Bench(
        arm=arm, ask=user, step_rad=STEP, speed_rad_per_s=SPEED, **{**settings, **options}
    )
    with closing(arm):
        return list(check(bench, last=last))


def turning_only(joint: int) -> User:
    """Refuses to have any other joint turned."""
    return User(*(f"Joint {j} will turn" for j in range(1, 8) if j != joint))


def failed(findings: list[CheckFinding]) -> list[tuple[str, int | None]]:
    return [(f.name, f.joint) for f in findings if f.passed is False]


@pytest.mark.campaign
def test_sound_arm_passes_every_stage_with_consent_per_motion(bench):
    # An encoder and an RVDT; the other joints are declined.
    turned, declined = [1, 6], [2, 3, 4, 5, 7]
    user = User(*(f"Joint {j} will" for j in declined))
    home = bench.plant.angles_rad[0]
    findings = findings_of(arm_of(bench), user)
    assert failed(findings) == []
    assert [f.stage for f in findings] == sorted((f.stage for f in findings), key=list(Stage).index)
    assert {f.stage for f in findings} == set(Stage)
    for name in ("alone", "halts", "Ctrl-C", "STOP on the way", "frees", "free stays free"):
        assert [f.joint for f in findings if f.name == name] == turned, name
    assert [f.joint for f in findings if f.name == "agreed"] == declined * 2
    assert [f.name for f in findings if f.passed is None and f.name != "agreed"] == list(NOT_TESTED)
    # Towards the farther limit, to the count of the encoder; and back.
    first_move, _ = [f.text for f in findings if f.name == "moves" and f.joint == 1]
    assert first_move == "commanded to turn by -1.000 deg, it reads -1.000 deg"
    assert bench.plant.angles_rad[0] == pytest.approx(home, abs=1e-3)
    assert len([q for q in user.questions if "will turn by" in q]) == 7
    assert len([q for q in user.questions if "will be set to free mode" in q]) == 7
    assert "fall silent for 3.0 s" in user.questions[-1]
    (stops,) = [f for f in findings if f.name == "stops alone"]
    assert stops.text == ("no drive stayed enabled; faults: operator's heartbeat lost (8130h)")


def test_look_stage_needs_no_consent_and_enables_nothing(bench):
    user = User()
    findings = findings_of(arm_of(bench), user, Stage.LOOK)
    assert (failed(findings), user.questions) == ([], [])
    assert all(mode is None for mode, _ in bench.plant.commands)


def test_declined_stop_test_enables_no_drive(bench):
    """No to enabling, and yes to the later questions: a closed arm, silence."""
    user = User("Enable them?", "Turn it?", "Free it?", "Release it?")
    findings = findings_of(arm_of(bench), user)
    assert failed(findings) == []
    assert findings[-1].passed is None
    assert "no later check is run" in findings[-1].text
    assert len(user.questions) == 1
    assert {f.stage for f in findings} == {Stage.LOOK, Stage.HOLD}
    assert all(mode is None for mode, _ in bench.plant.commands)


def test_declined_joint_is_not_moved(bench):
    before = bench.plant.angles_rad[2]
    findings = findings_of(arm_of(bench), turning_only(5), Stage.MOVE)
    assert failed(findings) == []
    assert [f.text for f in findings if f.joint == 3 and f.stage is Stage.MOVE] == [
        "not tried: declined"
    ]
    assert bench.plant.angles_rad[2] == pytest.approx(before, abs=1e-3)


def test_wrong_direction_ends_check(bench):
    user = turning_only(2)
    user.refused += ("Did joint 2",)
    findings = findings_of(arm_of(bench), user)
    assert failed(findings) == [("direction", 2)]
    assert {f.stage for f in findings} == {Stage.LOOK, Stage.HOLD, Stage.MOVE}


def test_stuck_joint_is_reported(bench):
    bench.plant.stuck.add(4)
    findings = findings_of(arm_of(bench), turning_only(4), Stage.MOVE)
    # Its drive may trip first.
    assert failed(findings)[0] in (("moves", 4), ("no error", None))


def test_drive_without_heartbeat_guard_is_not_enabled(settings, foreign):
    user = User()
    findings = findings_of(unconnected(settings, drafted(settings)), user)
    assert failed(findings) == [("guard", j) for j in range(1, JOINTS + 1)]
    assert user.questions == []
    assert {axis.status for axis in foreign.axes} == {0x40}
    # These drives lack the objects for modes and quick stop.
    assert [f.passed for f in findings if f.name in ("modes", "quick stop")] == [None] * 8


def test_failed_connection_is_one_finding(bench):
    profile = replace(sarcos(), joints=sarcos().joints[:JOINTS])
    findings = findings_of(unconnected(BusSettings(channel=bench.channel), profile), User())
    assert failed(findings) == [("no error", None)]
    assert "The arm on the bus is not the one in the arm file" in findings[0].text


def test_ineffective_stop_ends_check(bench):
    arm, user = arm_of(bench), User()
    arm.stop = lambda: None
    findings = findings_of(arm, user)
    assert failed(findings) == [("STOP", None)]
    assert findings[-1].text == f"joint 1, 2, 3, 4, 5, 6, 7 {STILL_ENABLED}"
    assert not [q for q in user.questions if "will turn by" in q]


def test_drive_enabled_after_stop_during_move_fails(bench):
    class SecondStopIgnored(CanopenArm):
        """An arm whose joint 2 stays enabled after the second STOP."""

        presses = 0

        def stop(self) -> None:
            self.presses += 1
            super().stop()

        def snapshot(self) -> ArmSnapshot:
            snapshot = super().snapshot()
            if self.presses < 2 or not snapshot.stopped:
                return snapshot
            joints = list(snapshot.joints)
            joints[1] = replace(joints[1], drive=DriveState.OPERATION_ENABLED)
            return replace(snapshot, joints=tuple(joints))

    arm = arm_of(bench)
    arm.__class__ = SecondStopIgnored
    findings = findings_of(arm, turning_only(1), Stage.MOVE)
    assert failed(findings) == [("STOP on the way", 1)]
    assert findings[-1].text == f"joint 2 {STILL_ENABLED}"


def test_ctrl_c_of_the_user_is_raised(bench):
    def press_ctrl_c(*_: object, **__: object) -> MoveResult:
        raise KeyboardInterrupt

    with closing(arm_of(bench)) as arm:
        arm.connect()
        arm.move = press_ctrl_c
        turn = Turn(arm=arm, joint=1, target_rad=0.1, speed_rad_per_s=SPEED, bounds=BENCH)
        with pytest.raises(KeyboardInterrupt):
            list(is_interrupted(turn, lambda: None))


class WithoutOperators(VirtualBus):
    """A handle that receives no operator's heartbeat."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        message = super().recv(timeout)
        is_operator = (
            message is not None and message.arbitration_id == COB_HEARTBEAT + OPERATOR_NODE
        )
        return None if is_operator else message


@pytest.mark.parametrize("same_bus", [False, True])
def test_second_operator_that_connects_is_reported(bench, same_bus, monkeypatch):
    """On the same bus it has reset the nodes before it is refused by their holder: a finding as well."""
    arm = arm_of(bench)
    with nullcontext(bench) if same_bus else running_bench() as other_bench:
        other = arm_of(other_bench, open_main=lambda s: WithoutOperators(s.channel))
        monkeypatch.setattr(checks, "CanopenArm", lambda _: other)
        findings = findings_of(arm, User(), Stage.LOOK)
    assert failed(findings) == [("one operator", None)]
    assert "was let in" in findings[-1].text


@pytest.mark.campaign
@pytest.mark.parametrize(
    "pace", [pytest.param(Pace.REAL_TIME, marks=pytest.mark.real_time), Pace.FAST_FORWARD]
)
def test_drives_that_ignore_operator_loss_are_reported(pace):
    """Their 1016h states a time-out. The reset by the next connection, which stops them, does not count."""
    with running_bench(heartbeat_timeout_s=1e3) as bench:
        entry = OPERATOR_NODE << 16 | int(1e3 * HEARTBEAT_TIMEOUT_S)
        for drive in bench.controller.drives:
            drive.answers[HEARTBEAT_CONSUMER, 1] = entry
        findings = findings_of(arm_of(bench, pace=pace), User("Joint", "closed"))
        states = {drive.drive.state for drive in bench.controller.drives}
    assert failed(findings) == [("stops alone", None)]
    assert findings[-1].text == (
        "joint 1, 2, 3, 4, 5, 6, 7 was still enabled 3.0 s after this program fell silent"
    )
    assert DriveState.OPERATION_ENABLED not in states


def test_accepted_out_of_range_target_ends_check(bench):
    """The arm's own limits are wider than those of the arm file."""
    arm = arm_of(bench)
    description = arm.on_bus.description
    narrow = replace(
        description, joints=tuple(replace(j, upper_rad=0.5) for j in description.joints)
    )
    before = bench.plant.angles_rad[0]
    findings = findings_of(arm, User(), Stage.MOVE, description=narrow)
    assert failed(findings) == [("range", 1)]
    assert findings[-1].text == "a target of +30.648 deg was not refused"
    assert bench.plant.angles_rad[0] == pytest.approx(before, abs=STEP)
