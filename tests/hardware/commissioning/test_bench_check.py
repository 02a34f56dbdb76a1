"""What a check on the bench tries, asks, finds and leaves behind."""

import itertools
import math
import os
import signal
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import replace
from typing import Any

import can
import pytest
from can.interfaces.virtual import VirtualBus

from hardware.arm import ArmSnapshot, DriveState, MoveResult
from hardware.arm_description import EncoderDescription, RvdtDescription
from hardware.buses.python_can import BusOpeners, BusSettings, open_bus
from hardware.canopen.objects import COB_HEARTBEAT, HEARTBEAT_CONSUMER, OPERATOR_NODE
from hardware.commissioning.bench_check import NOT_TESTED, check
from hardware.commissioning.bench_check import Bench as Tried
from hardware.commissioning.checks import Turn, is_interrupted
from hardware.commissioning.stages import BENCH, CheckFinding, Stage
from hardware.control.canopen_arm import CanopenArm
from hardware.timing import Pace, Timing
from hardware.virtual.controller import VirtualController
from tests.hardware.on_foreign_arm import DESCRIPTION as ACME
from tests.hardware.on_foreign_arm import JOINTS, drafted
from tests.oracles.descriptions import described
from tests.oracles.profiles import sarcos
from tests.oracles.virtual_rig import ARM, COUNTS_PER_REV, TrivialPlant, axes, parse

WATCH_S = 1.5
STEP, SPEED = math.radians(1.0), math.radians(5.0)
_channels = itertools.count()


class Bystander:
    """Answers yes to what does not begin with a word that is refused."""

    def __init__(self, *refused: str) -> None:
        self.refused, self.asked = refused, list[str]()

    def __call__(self, question: str) -> bool:
        self.asked.append(question)
        return not any(word in question for word in self.refused)


class Bench:
    """Joints that move by themselves, as on a bench, behind our own drives."""

    def __init__(self, stack: ExitStack, *, watches: bool = True) -> None:
        self.settings = BusSettings(channel=f"bench-{next(_channels)}")
        self.plant = TrivialPlant([axis.scale.counts_per_rad for axis in axes()])
        bus = stack.enter_context(can.Bus(self.settings.channel, interface="virtual"))
        self.controller = stack.enter_context(
            VirtualController(
                bus,
                self.plant,
                axes=axes(),
                arm=ARM,
                validate=parse,
                heartbeat_timeout_s=WATCH_S if watches else 1e3,
            )
        )
        if not watches:  # and says that it does
            for drive in self.controller.drives:
                drive.serve(HEARTBEAT_CONSUMER, 1, lambda: OPERATOR_NODE << 16 | int(1e3 * WATCH_S))

    def arm(
        self, pace: Pace = Pace.FAST_FORWARD, opener: Callable[[BusSettings], can.BusABC] = open_bus
    ) -> CanopenArm:
        rvdt = RvdtDescription(bits=12, full_scale_rad=math.radians(144.0))
        encoder = EncoderDescription(counts_per_rev=COUNTS_PER_REV)
        description = described(
            ARM.model,
            *((sensor, math.radians(60.0)) for sensor in [encoder] * 5 + [rvdt] * 2),
            max_speed_rad_per_s=math.radians(180.0),
            max_torque_nm=100.0,
        )
        return patient(description, self.settings, sarcos(), pace=pace, opener=opener)


def patient(
    *args: Any, opener: Callable[[BusSettings], can.BusABC] = open_bus, **options: Any
) -> CanopenArm:
    timing = Timing(
        listen_s=0.15,
        answer_timeouts_s=dict.fromkeys(Pace, 2.0),
        heartbeat_timeout_s=5.0,
        lost_after_s=5.0,
    )
    options = {"pace": Pace.FAST_FORWARD} | options
    return CanopenArm(*args, timing=timing, openers=BusOpeners(main=opener), **options)


@pytest.fixture
def bench():
    with ExitStack() as stack:
        yield Bench(stack)


def tried(arm: CanopenArm, who: Bystander, last: Stage = Stage.SILENCE) -> list[CheckFinding]:
    bench = Tried(
        arm=arm,
        description=arm.on_bus.description,
        ask=who,
        step_rad=STEP,
        speed_rad_per_s=SPEED,
        interrupt=lambda: os.kill(os.getpid(), signal.SIGINT),
        bounds=replace(BENCH, samples=10),
    )
    try:
        return list(check(bench, last=last))
    finally:
        arm.close()


def others_than(joint: int) -> list[str]:
    """Questions to turn another one."""
    return [f"Joint {j} will turn" for j in range(1, 8) if j != joint]


def failed(findings: list[CheckFinding]) -> list[tuple[str, int | None]]:
    return [(f.name, f.joint) for f in findings if f.passed is False]


@pytest.mark.campaign
def test_sound_arm_passes_every_stage_with_consent_per_motion(bench):
    # An encoder, an RVDT; nobody wants the others moved.
    tried_joints, others = [1, 6], [2, 3, 4, 5, 7]
    who = Bystander(*(f"Joint {j} will" for j in others))
    home = bench.plant.angles_rad[0]
    findings = tried(bench.arm(), who)
    assert failed(findings) == []
    assert [f.stage for f in findings] == sorted((f.stage for f in findings), key=list(Stage).index)
    assert {f.stage for f in findings} == set(Stage)
    for name in ("alone", "halts", "Ctrl-C", "STOP on the way", "frees", "free stays free"):
        assert [f.joint for f in findings if f.name == name] == tried_joints, name
    assert [f.joint for f in findings if f.name == "agreed"] == others * 2
    assert [f.name for f in findings if f.passed is None and f.name != "agreed"] == list(NOT_TESTED)
    # The way in which there is more room, by the encoder to the count; and home again.
    there, _ = [f.text for f in findings if f.name == "moves" and f.joint == 1]
    assert there == "commanded to turn by -1.000 deg, it reads -1.000 deg"
    assert bench.plant.angles_rad[0] == pytest.approx(home, abs=1e-3)
    assert len([q for q in who.asked if "will turn by" in q]) == 7
    assert len([q for q in who.asked if "will be set to free mode" in q]) == 7
    assert "fall silent for 3.0 s" in who.asked[-1]
    (alone,) = [f for f in findings if f.name == "stops alone"]
    assert alone.text == ("no drive stayed enabled; faults: operator's heartbeat lost (8130h)")


def test_look_stage_needs_no_consent_and_enables_nothing(bench):
    who = Bystander()
    findings = tried(bench.arm(), who, Stage.LOOK)
    assert failed(findings) == []
    assert who.asked == []
    assert all(command.mode is None for command in bench.plant.commands)


def test_declined_stop_test_enables_no_drive(bench):
    """No to enabling, and yes to what comes after it: a closed arm, silence."""
    who = Bystander("Enable them?", "Turn it?", "Free it?", "Release it?")
    findings = tried(bench.arm(), who)
    assert failed(findings) == []
    assert findings[-1].passed is None
    assert "no later check is run" in findings[-1].text
    assert len(who.asked) == 1
    assert {f.stage for f in findings} == {Stage.LOOK, Stage.HOLD}
    assert all(command.mode is None for command in bench.plant.commands)


def test_declined_joint_is_not_moved(bench):
    before = bench.plant.angles_rad[2]
    findings = tried(bench.arm(), Bystander(*others_than(5)), Stage.MOVE)
    assert [f.text for f in findings if f.joint == 3 and f.stage is Stage.MOVE] == [
        "not tried: declined"
    ]
    assert bench.plant.angles_rad[2] == pytest.approx(before, abs=1e-3)


def test_wrong_direction_ends_check(bench):
    findings = tried(bench.arm(), Bystander("Did joint 2", *others_than(2)))
    assert failed(findings) == [("direction", 2)]
    assert {f.stage for f in findings} == {Stage.LOOK, Stage.HOLD, Stage.MOVE}


def test_stuck_joint_is_reported(bench):
    bench.plant.stuck.add(4)
    findings = tried(bench.arm(), Bystander(*others_than(4)), Stage.MOVE)
    told = failed(findings)
    assert told[0] in (("moves", 4), ("no error", None)), "it is told, or its drive trips"


def test_drive_without_heartbeat_guard_is_not_enabled(
    settings, foreign
):
    who = Bystander()
    findings = tried(patient(ACME, settings, drafted(settings)), who)
    assert failed(findings) == [("guard", j) for j in range(1, JOINTS + 1)]
    assert who.asked == []
    assert {axis.status for axis in foreign.axes} == {0x40}
    # What it says of stops and modes, this drive does not say at all.
    assert [f.passed for f in findings if f.name in ("modes", "quick stop")] == [None] * 8


def test_failed_connection_is_one_finding(bench):
    arm = CanopenArm(
        ACME,
        bench.settings,
        replace(sarcos(), joints=sarcos().joints[:JOINTS]),
        pace=Pace.FAST_FORWARD,
    )
    findings = tried(arm, Bystander())
    assert failed(findings) == [("no error", None)]
    assert "The arm on the bus is not the one in the arm file" in findings[0].text


class Deaf(CanopenArm):
    """An arm whose STOP does not arrive."""

    def stop(self) -> None:
        """Hear nothing."""


def test_ineffective_stop_ends_check(bench):
    arm = bench.arm()
    arm.__class__ = Deaf
    who = Bystander()
    findings = tried(arm, who)
    assert failed(findings) == [("STOP", None)]
    assert findings[-1].text == "a drive is still enabled 0.5 s after STOP"
    assert not [q for q in who.asked if "will turn by" in q]


class Lingering(CanopenArm):
    """An arm whose joint 2 has not heard the second STOP."""

    presses = 0

    def stop(self) -> None:
        """Count."""
        self.presses += 1
        super().stop()

    def snapshot(self) -> ArmSnapshot:
        """Say that joint 2 goes on."""
        found = super().snapshot()
        if self.presses < 2 or not found.stopped:
            return found
        joints = list(found.joints)
        joints[1] = replace(joints[1], drive=DriveState.OPERATION_ENABLED)
        return replace(found, joints=tuple(joints))


def test_drive_enabled_after_stop_during_move_fails(bench):
    arm = bench.arm()
    arm.__class__ = Lingering
    findings = tried(arm, Bystander(*others_than(1)), Stage.MOVE)
    assert failed(findings) == [("STOP on the way", 1)]
    assert findings[-1].text == "a drive is still enabled 0.5 s after STOP"


class Interrupted(CanopenArm):
    """An arm at which somebody presses Ctrl-C as soon as it is to move."""

    def move(self, *_: object, **__: object) -> MoveResult:
        """Be interrupted."""
        raise KeyboardInterrupt


def test_ctrl_c_of_the_user_is_raised(bench):
    arm = bench.arm()
    with closing(arm):
        arm.connect()
        arm.__class__ = Interrupted
        turn = Turn(arm=arm, joint=1, target_rad=0.1, speed_rad_per_s=SPEED, bounds=BENCH)
        with pytest.raises(KeyboardInterrupt):
            list(is_interrupted(turn, lambda: None))


class Alone(CanopenArm):
    """An arm whose second program is this one."""

    other: CanopenArm

    def another(self) -> CanopenArm:
        return self.other


class WithoutOperators(VirtualBus):
    """A handle that hears no operator."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        message = super().recv(timeout)
        is_operator = (
            message is not None and message.arbitration_id == COB_HEARTBEAT + OPERATOR_NODE
        )
        return None if is_operator else message


@pytest.mark.parametrize("same_bus", [False, True])
def test_second_operator_that_connects_is_reported(bench, same_bus):
    """On the same bus it is refused after it has reset the nodes, once it hears who commands them: let in as well."""
    arm = bench.arm()
    with ExitStack() as elsewhere:
        arm.__class__ = Alone
        arm.other = (bench if same_bus else Bench(elsewhere)).arm(
            opener=lambda s: WithoutOperators(s.channel)
        )
        findings = tried(arm, Bystander(), Stage.LOOK)
    assert failed(findings) == [("one operator", None)]
    assert "was let in" in findings[-1].text


@pytest.mark.campaign
@pytest.mark.parametrize(
    "pace", [pytest.param(Pace.REAL_TIME, marks=pytest.mark.real_time), Pace.FAST_FORWARD]
)
def test_drives_that_ignore_operator_loss_are_reported(pace):
    """They say in 1016h that they watch. The reset of a new connection stops them: that is not alone."""
    with ExitStack() as stack:
        bench = Bench(stack, watches=False)
        findings = tried(bench.arm(pace), Bystander("Joint", "closed"))
        drives = {drive.drive.state for drive in bench.controller.drives}
    assert failed(findings) == [("stops alone", None)]
    assert findings[-1].text == (
        "joint 1, 2, 3, 4, 5, 6, 7 was still enabled 3.0 s after this program fell silent"
    )
    assert DriveState.OPERATION_ENABLED not in drives


def test_accepted_out_of_range_target_ends_check(bench):
    """The arm's own limits are wider than those of the arm file."""
    arm = bench.arm()
    narrow = tuple(replace(j, upper_rad=0.5) for j in arm.on_bus.description.joints)
    before = bench.plant.angles_rad[0]
    made = Tried(
        arm=arm,
        description=replace(arm.on_bus.description, joints=narrow),
        ask=Bystander(),
        step_rad=STEP,
        speed_rad_per_s=SPEED,
    )
    found = list(check(made, last=Stage.MOVE))
    arm.close()
    assert failed(found) == [("range", 1)]
    assert found[-1].text == "a target of +30.648 deg was not refused"
    assert bench.plant.angles_rad[0] == pytest.approx(before, abs=STEP)
