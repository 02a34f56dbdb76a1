"""What the operator side lets out: boundary by boundary, in counts."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from hardware.arm import DriveState, JointMode
from hardware.arm_description import JointScale
from hardware.canopen.cyclic import Sample, Setpoint
from hardware.command_limits import JointLimits
from hardware.errors import CommandRefused, StopLatched
from hardware.monitors.admission import admit, admit_move, not_enabled
from tests.oracles.samples import sample

LIMITS = (
    JointLimits(
        joint=1, lower_counts=-500, upper_counts=500, max_speed_rad_per_s=1.0, max_step_counts=10
    ),
)
ENABLED, QUICK_STOPPED, SWITCHED_ON = 0x0627, 0x0607, 0x0623
GO, ON, OFF = 0x000F, 0x0007, 0x0000
CSP, CST = 8, 10


def try_to_send(
    before: Setpoint | None,
    command: Setpoint,
    *,
    measured: int = 100,
    status: int = ENABLED,
    mode: JointMode | None = JointMode.POSITION,
    **situation: Any,
) -> None:
    situation = {"in_control": True, "stopped": False, **situation}
    admit(
        LIMITS,
        (mode,),
        sample=sample((status,), (measured,)),
        before=None if before is None else (before,),
        commands=(command,),
        **situation,
    )


@pytest.mark.parametrize("step", [-10, -1, 0, 1, 10])
def test_a_step_within_the_limit_passes(step):
    try_to_send(Setpoint(GO, 100, CSP), Setpoint(GO, 100 + step, CSP))


@pytest.mark.parametrize(
    ("before", "command", "situation", "words"),
    [
        (Setpoint(GO, 100, CSP), Setpoint(GO, 89, CSP), {}, "step"),
        (Setpoint(GO, 100, CSP), Setpoint(GO, 111, CSP), {}, "step"),
        (Setpoint(GO, 100, CSP), Setpoint(GO, 100_100, CSP), {}, "step"),
        (Setpoint(GO, 495, CSP), Setpoint(GO, 501, CSP), {}, "outside"),
        # A stale target of a free joint, and one of another mode, are no excuse.
        (Setpoint(GO, -400, CST), Setpoint(GO, -400, CSP), {"mode": JointMode.FREE}, "step"),
        (Setpoint(GO, 300, 1), Setpoint(GO, 300, CSP), {}, "step"),
        # A target from before a drive had power is where its joint was then.
        (Setpoint(ON, 300, CSP), Setpoint(GO, 300, CSP), {"status": SWITCHED_ON}, "step"),
        # Whatever enables a drive is looked at.
        *(
            (Setpoint(GO, 100, CSP), Setpoint(w, 9999, CSP), {}, "step")
            for w in (0x1F, 0x10F, 0x800F)
        ),
    ],
)
def test_a_larger_step_and_a_target_outside_are_refused(before, command, situation, words):
    with pytest.raises(CommandRefused, match=words):
        try_to_send(before, command, **situation)


def test_until_its_drive_has_power_a_joint_that_sinks_is_followed():
    sunk = {"status": SWITCHED_ON, "measured": 60}
    try_to_send(Setpoint(ON, 100, CSP), Setpoint(GO, 60, CSP), **sunk)
    try_to_send(Setpoint(GO, 100, CSP), Setpoint(GO, 60, CSP), **sunk)


@pytest.mark.parametrize(
    "situation",
    [
        {"in_control": False},
        {"status": QUICK_STOPPED},
        {"mode": None, "measured": 400},
        {"mode": JointMode.FREE, "measured": 400},
    ],
)
def test_target_in_wrong_state_is_refused(situation, approve):
    with pytest.raises(CommandRefused) as refused:
        try_to_send(Setpoint(GO, 100, CSP), Setpoint(GO, 105, CSP), **situation)
    approve(str(refused.value))


def test_stop_is_said_as_stop():
    with pytest.raises(StopLatched):
        try_to_send(Setpoint(GO, 100, CSP), Setpoint(GO, 105, CSP), stopped=True)


@pytest.mark.parametrize("before", [None, Setpoint(GO, -400, CST)])
def test_entering_position_mode_is_only_allowed_where_the_joint_is(before):
    try_to_send(before, Setpoint(GO, 110, CSP), mode=JointMode.FREE)
    with pytest.raises(CommandRefused, match="step"):
        try_to_send(before, Setpoint(GO, 111, CSP), mode=JointMode.FREE)


def test_what_cannot_move_a_drive_always_passes():
    for command in (Setpoint(OFF, 9999, CSP), Setpoint(0x0002, 9999, CSP), Setpoint(GO, 9999, CST)):
        try_to_send(Setpoint(GO, 100, CSP), command)


def test_modes_need_every_drive_enabled():
    sample = Sample(
        sync_count=1, statuswords=(ENABLED, 0x0218), counts=(0, 0), torques_per_mille=(0, 0)
    )
    refused = not_enabled(sample)
    assert "joint 2: the drive is in state fault" in str(refused)


@pytest.mark.parametrize(
    ("before", "target", "measured", "mode"),
    [
        pytest.param(Setpoint(0x07, 600, CSP), int("600"), 600, JointMode.POSITION, id="as before"),
        pytest.param(Setpoint(GO, 0, CST), 600, 600, JointMode.FREE, id="held beyond its range"),
        pytest.param(Setpoint(GO, 0, CST), 610, 600, JointMode.FREE, id="near, beyond its range"),
        pytest.param(Setpoint(GO, 0, CSP), 129, 127, JointMode.FREE, id="not switched yet"),
        pytest.param(None, 600, 600, JointMode.POSITION, id="the first, beyond its range"),
    ],
)
def test_a_target_may_be_where_it_was_or_near_the_joint_wherever_that_is(
    before, target, measured, mode
):
    try_to_send(before, Setpoint(GO, target, CSP), measured=measured, mode=mode)


TWO = (
    *LIMITS,
    JointLimits(
        joint=2, lower_counts=-50, upper_counts=50, max_speed_rad_per_s=2.0, max_step_counts=10
    ),
)
SCALES = (JointScale(counts_per_rad=100.0), JointScale(counts_per_rad=1000.0))
BOTH = (JointMode.POSITION, JointMode.POSITION)
ON, FAULT = DriveState.OPERATION_ENABLED, DriveState.FAULT


def joint_state(drive, mode):
    return SimpleNamespace(drive=drive, mode=mode)


def try_to_send_both(before: tuple[Setpoint, ...] | None, *commands: Setpoint) -> None:
    admit(
        TWO,
        BOTH,
        in_control=True,
        stopped=False,
        sample=sample((ENABLED, ENABLED)),
        before=before,
        commands=commands,
    )


@pytest.mark.parametrize(
    "harmless", [Setpoint(OFF, 0, CSP), Setpoint(GO, 0, CST), Setpoint(0x1F, 0, CSP)]
)
def test_every_joint_is_looked_at(harmless):
    with pytest.raises(CommandRefused, match="joint 2"):
        try_to_send_both(
            (Setpoint(GO, 0, CSP), Setpoint(GO, 0, CSP)), harmless, Setpoint(GO, 40, CSP)
        )
    with pytest.raises(ValueError, match="argument"):
        try_to_send_both(None, harmless)


def try_to_move(
    targets_rad: dict[int, float],
    *,
    speed: float = 1.0,
    drives: tuple[DriveState, DriveState] = (ON, ON),
    modes: tuple[JointMode | None, JointMode | None] = BOTH,
    in_control: bool = True,
) -> None:
    joints = list(map(joint_state, drives, modes))
    admit_move(TWO, SCALES, joints, targets_rad, speed_rad_per_s=speed, in_control=in_control)


def test_a_move_inside_all_limits_begins():
    try_to_move({})
    try_to_move({1: 5.0})
    try_to_move({2: -0.05})
    try_to_move({1: -5.0, 2: 0.05})
    try_to_move({1: 1.0}, drives=(ON, FAULT), modes=(JointMode.POSITION, None))
    try_to_move({2: 0.01}, speed=2.0, drives=(FAULT, ON), modes=(None, JointMode.POSITION))


@pytest.mark.parametrize(
    ("targets_rad", "situation"),
    [
        ({1: 5.02}, {}),
        ({1: 0.0, 2: 0.052}, {}),
        ({1: 0.0, 2: 0.0}, {"speed": 1.1}),
        ({2: 0.0}, {"in_control": False}),
        ({1: 0.0}, {"drives": (FAULT, ON)}),
        ({1: 0.0, 2: 0.0}, {"drives": (ON, FAULT)}),
        ({2: 0.0}, {"modes": (JointMode.POSITION, JointMode.FREE)}),
    ],
)
def test_move_outside_limits_or_state_is_refused(targets_rad, situation, approve):
    with pytest.raises(CommandRefused) as refused:
        try_to_move(targets_rad, **situation)
    approve(str(refused.value))


def test_every_joint_moves_within_its_own_limits():
    wide = replace(TWO[1], joint=3, lower_counts=-5000, upper_counts=5000)
    admit_move(
        (*TWO, wide),
        (*SCALES, JointScale(counts_per_rad=500.0)),
        [joint_state(FAULT, None), joint_state(FAULT, None), joint_state(ON, JointMode.POSITION)],
        {3: 8.0},
        speed_rad_per_s=1.0,
        in_control=True,
    )


@pytest.mark.parametrize("joint", [-1, 0, 3])
def test_a_move_of_a_joint_that_is_not_there(joint):
    with pytest.raises(ValueError, match=f"no joint {joint}"):
        try_to_move({joint: 0.0})
