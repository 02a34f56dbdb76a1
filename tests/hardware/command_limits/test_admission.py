from types import SimpleNamespace
from typing import Any

import pytest

from hardware.arm import DriveState, JointMode
from hardware.arm_description import JointScale
from hardware.canopen.cyclic import Setpoint
from hardware.command_limits import JointLimits, admit, admit_move, not_enabled
from hardware.errors import CommandRefused, StopLatched
from tests.oracles.samples import sample


def limits(joint: int, counts: int, speed_rad_per_s: float) -> JointLimits:
    return JointLimits(
        joint=joint, lower_counts=-counts, upper_counts=counts, max_speed_rad_per_s=speed_rad_per_s,
        max_step_counts=10,
    )  # fmt: skip


ONE = (limits(1, 500, 1.0),)
TWO = (*ONE, limits(2, 50, 2.0))
THREE = (*TWO, limits(3, 5000, 2.0))
SCALES = tuple(JointScale(counts_per_rad=scale) for scale in (100.0, 1000.0, 500.0))
ENABLED, QUICK_STOPPED, SWITCHED_ON, FAULTY = 0x0627, 0x0607, 0x0623, 0x0218
ENABLE, SWITCH_ON, DISABLE, QUICK_STOP = 0x000F, 0x0007, 0x0000, 0x0002
CSP, CST = POSITION, FREE = JointMode.POSITION, JointMode.FREE
ON, FAULT = DriveState.OPERATION_ENABLED, DriveState.FAULT
AT_60, AT_100, AT_110, AT_600 = (Setpoint(ENABLE, n, CSP) for n in (60, 100, 110, 600))
FREE_AT_MINUS_400 = Setpoint(ENABLE, -400, CST)


def send(
    before: Setpoint | None,
    command: Setpoint,
    *,
    measured: int = 100,
    status: int = ENABLED,
    mode: JointMode | None = POSITION,
    missing: tuple[int, ...] = (),
    **situation: Any,
) -> None:
    situation = {"in_control": True, "stopped": False, **situation}
    admit(
        ONE,
        (mode,),
        sample=sample((status,), (measured,), missing=missing),
        before=None if before is None else (before,),
        commands=(command,),
        **situation,
    )


@pytest.mark.parametrize(
    ("before", "command", "situation"),
    [
        *((AT_100, Setpoint(ENABLE, target, CSP), {}) for target in (90, 99, 100, 101, 110)),
        # A joint sinks until its drive has power: the target is its measured position.
        (Setpoint(SWITCH_ON, 100, CSP), AT_60, {"status": SWITCHED_ON, "measured": 60}),
        (AT_100, AT_60, {"status": SWITCHED_ON, "measured": 60}),
        # Commands that do not move a drive.
        (AT_100, Setpoint(DISABLE, 9999, CSP), {}),
        (AT_100, Setpoint(QUICK_STOP, 9999, CSP), {}),
        (AT_100, Setpoint(ENABLE, 9999, CST), {}),
        # Beyond the range: an unchanged target, and targets at or near the position before the mode has switched.
        (Setpoint(SWITCH_ON, 600, CSP), AT_600, {"measured": 600}),
        (None, AT_600, {"measured": 600}),
        (Setpoint(ENABLE, 0, CST), AT_600, {"measured": 600, "mode": FREE}),
        (Setpoint(ENABLE, 0, CST), AT_600, {"measured": 590, "mode": FREE}),
        (Setpoint(ENABLE, 0, CSP), Setpoint(ENABLE, 129, CSP), {"measured": 127, "mode": FREE}),
        *((before, AT_110, {"mode": FREE}) for before in (None, FREE_AT_MINUS_400)),
    ],
)
def test_allowed_step_target_at_position_and_harmless_command_are_admitted(
    before, command, situation
):
    send(before, command, **situation)


@pytest.mark.parametrize(
    ("before", "command", "situation", "reason"),
    [
        (AT_100, Setpoint(ENABLE, 89, CSP), {}, "step"),
        (AT_100, Setpoint(ENABLE, 111, CSP), {}, "step"),
        (AT_100, Setpoint(ENABLE, 100_100, CSP), {}, "step"),
        (Setpoint(ENABLE, 495, CSP), Setpoint(ENABLE, 501, CSP), {}, "outside"),
        # An old target of a joint in free mode is no reference.
        (FREE_AT_MINUS_400, Setpoint(ENABLE, -400, CSP), {"mode": FREE}, "step"),
        *(
            (b, Setpoint(ENABLE, 111, CSP), {"mode": FREE}, "step")
            for b in (None, FREE_AT_MINUS_400)
        ),
        (Setpoint(ENABLE, 300, CST), Setpoint(ENABLE, 300, CSP), {}, "step"),
        # Nor is a target from before its drive had power.
        (
            Setpoint(SWITCH_ON, 300, CSP),
            Setpoint(ENABLE, 300, CSP),
            {"status": SWITCHED_ON},
            "step",
        ),
        # Every controlword that enables a drive is checked.
        *((AT_100, Setpoint(word, 9999, CSP), {}, "step") for word in (0x1F, 0x10F, 0x800F)),
    ],
)
def test_larger_step_and_target_outside_range_are_refused(before, command, situation, reason):
    with pytest.raises(CommandRefused, match=reason):
        send(before, command, **situation)


@pytest.mark.parametrize(
    "situation",
    [
        {"in_control": False},
        {"status": QUICK_STOPPED},
        {"mode": None, "measured": 400},
        {"mode": FREE, "measured": 400},
    ],
)
def test_target_in_wrong_state_is_refused(situation, approve):
    with pytest.raises(CommandRefused) as refused:
        send(AT_100, Setpoint(ENABLE, 105, CSP), **situation)
    approve(str(refused.value))


def test_target_after_stop_raises_stop_latched():
    with pytest.raises(StopLatched):
        send(AT_100, Setpoint(ENABLE, 105, CSP), stopped=True)


@pytest.mark.parametrize("before", [None, Setpoint(ENABLE, 100, CST)])
def test_position_mode_is_not_entered_at_an_old_position(before, approve):
    with pytest.raises(CommandRefused) as refused:
        send(before, AT_100, mode=FREE, missing=(1,))
    approve(str(refused.value))
    send(AT_100, Setpoint(ENABLE, 105, CSP), missing=(1,))


def test_not_enabled_reports_the_first_drive_not_enabled():
    assert "joint 2: the drive is in state 'fault'" in str(not_enabled(sample((ENABLED, FAULTY))))


@pytest.mark.parametrize(
    "harmless", [Setpoint(DISABLE, 0, CSP), Setpoint(ENABLE, 0, CST), Setpoint(0x1F, 0, CSP)]
)
def test_every_joint_is_checked(harmless):
    def send_both(before: tuple[Setpoint, ...] | None, *commands: Setpoint) -> None:
        admit(
            TWO,
            (POSITION, POSITION),
            in_control=True,
            stopped=False,
            sample=sample((ENABLED, ENABLED)),
            before=before,
            commands=commands,
        )

    at_zero = Setpoint(ENABLE, 0, CSP)
    with pytest.raises(CommandRefused, match="joint 2"):
        send_both((at_zero, at_zero), harmless, Setpoint(ENABLE, 40, CSP))
    with pytest.raises(ValueError, match="argument"):
        send_both(None, harmless)


def move(
    targets_rad: dict[int, float],
    *,
    speed: float = 1.0,
    drives: tuple[DriveState, ...] = (ON, ON),
    modes: tuple[JointMode | None, ...] = (POSITION, POSITION),
    in_control: bool = True,
) -> None:
    """Move the joints of an arm of three; joint 3 is in fault unless stated otherwise."""
    states = zip((*drives, FAULT)[:3], (*modes, None)[:3], strict=True)
    joints: Any = [SimpleNamespace(drive=drive, mode=mode) for drive, mode in states]
    admit_move(THREE, SCALES, joints, targets_rad, speed_rad_per_s=speed, in_control=in_control)


def test_move_within_limits_of_its_joints_is_admitted():
    move({})
    move({1: 5.0})
    move({2: -0.05})
    move({1: -5.0, 2: 0.05})
    move({1: 1.0}, drives=(ON, FAULT), modes=(POSITION, None))
    move({2: 0.01}, speed=2.0, drives=(FAULT, ON), modes=(None, POSITION))
    move({3: 8.0}, drives=(FAULT, FAULT, ON), modes=(None, None, POSITION))


@pytest.mark.parametrize(
    ("targets_rad", "situation"),
    [
        ({1: 5.02}, {}),
        ({1: 0.0, 2: 0.052}, {}),
        ({1: 0.0, 2: 0.0}, {"speed": 1.1}),
        ({2: 0.0}, {"in_control": False}),
        ({1: 0.0}, {"drives": (FAULT, ON)}),
        ({1: 0.0, 2: 0.0}, {"drives": (ON, FAULT)}),
        ({2: 0.0}, {"modes": (POSITION, FREE)}),
    ],
)
def test_move_outside_limits_or_state_is_refused(targets_rad, situation, approve):
    with pytest.raises(CommandRefused) as refused:
        move(targets_rad, **situation)
    approve(str(refused.value))


@pytest.mark.parametrize("joint", [-1, 0, 4])
def test_move_of_unknown_joint_is_refused(joint):
    with pytest.raises(ValueError, match=f"no joint {joint}"):
        move({joint: 0.0})
