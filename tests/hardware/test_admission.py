"""What the operator side lets out: boundary by boundary, in counts."""

from __future__ import annotations

from typing import Any

import pytest

from hardware.admission import admit, admit_modes
from hardware.arm import JointMode
from hardware.cyclic import Sample, Setpoint
from hardware.errors import CommandRefused, Stopped
from hardware.limits import JointLimits

LIMITS = (
    JointLimits(
        joint=1, lower_counts=-500, upper_counts=500, max_speed_rad_per_s=1.0, max_step_counts=10
    ),
)
ENABLED, QUICK_STOPPED = 0x0627, 0x0607
GO, OFF = 0x000F, 0x0000
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
    sample = Sample(sync_count=7, statuswords=(status,), counts=(measured,), torques_per_mille=(0,))
    admit(
        LIMITS,
        (mode,),
        sample=sample,
        before=None if before is None else (before,),
        commands=(command,),
        **situation,
    )


@pytest.mark.parametrize("step", [-10, -1, 0, 1, 10])
def test_a_step_within_the_limit_passes(step: int) -> None:
    try_to_send(Setpoint(GO, 100, CSP), Setpoint(GO, 100 + step, CSP))


@pytest.mark.parametrize("step", [-11, 11, 100_000])
def test_a_larger_step_is_refused(step: int) -> None:
    with pytest.raises(CommandRefused, match="step"):
        try_to_send(Setpoint(GO, 100, CSP), Setpoint(GO, 100 + step, CSP))


def test_the_range_ends_at_its_ends() -> None:
    try_to_send(Setpoint(GO, 495, CSP), Setpoint(GO, 500, CSP))
    with pytest.raises(CommandRefused, match="outside"):
        try_to_send(Setpoint(GO, 495, CSP), Setpoint(GO, 501, CSP))


@pytest.mark.parametrize(
    ("situation", "words"),
    [
        ({"in_control": False}, "control"),
        ({"status": QUICK_STOPPED}, "quick stop active"),
        ({"mode": None, "measured": 400}, "no known mode"),
        ({"mode": JointMode.FREE, "measured": 400}, "free mode"),
    ],
)
def test_a_new_target_needs_the_right_situation(situation: dict[str, Any], words: str) -> None:
    with pytest.raises(CommandRefused, match=words):
        try_to_send(Setpoint(GO, 100, CSP), Setpoint(GO, 105, CSP), **situation)


def test_stop_is_said_as_stop() -> None:
    with pytest.raises(Stopped):
        try_to_send(Setpoint(GO, 100, CSP), Setpoint(GO, 105, CSP), stopped=True)


@pytest.mark.parametrize("before", [None, Setpoint(GO, -400, CST)])
def test_entering_position_mode_is_only_allowed_where_the_joint_is(before: Setpoint | None) -> None:
    try_to_send(before, Setpoint(GO, 110, CSP), mode=JointMode.FREE)
    with pytest.raises(CommandRefused, match="step"):
        try_to_send(before, Setpoint(GO, 111, CSP), mode=JointMode.FREE)


def test_a_joint_beyond_its_range_may_be_held_there() -> None:
    try_to_send(Setpoint(GO, 0, CST), Setpoint(GO, 600, CSP), measured=600, mode=JointMode.FREE)


def test_a_stale_target_of_a_free_joint_is_no_excuse() -> None:
    with pytest.raises(CommandRefused, match="step"):
        try_to_send(Setpoint(GO, -400, CST), Setpoint(GO, -400, CSP), mode=JointMode.FREE)


def test_what_cannot_move_a_drive_always_passes() -> None:
    for command in (Setpoint(OFF, 9999, CSP), Setpoint(0x0002, 9999, CSP), Setpoint(GO, 9999, CST)):
        try_to_send(Setpoint(GO, 100, CSP), command)


def test_modes_need_every_drive_enabled() -> None:
    sample = Sample(
        sync_count=1, statuswords=(ENABLED, 0x0218), counts=(0, 0), torques_per_mille=(0, 0)
    )
    with pytest.raises(CommandRefused, match=r"joint 2: the drive is in fault"):
        admit_modes(sample)
