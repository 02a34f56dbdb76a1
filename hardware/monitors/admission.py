"""Checks every change of a command against `hardware.command_limits` before it is sent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hardware.arm import DriveState, JointMode, JointState
from hardware.arm_description import JointScale
from hardware.canopen.cia402 import CLOSED_LOOP_STATES, Command, command_of, conditions, state_of
from hardware.canopen.cyclic import Sample, Setpoints
from hardware.canopen.objects import CYCLIC_POSITION
from hardware.command_limits import JointLimits, refuse_command, refuse_move, refuse_target
from hardware.errors import CommandRefused, DriveNotReady, StopLatched


def admit(
    limits: Sequence[JointLimits],
    modes: Sequence[JointMode | None],
    *,
    in_control: bool,
    stopped: bool,
    sample: Sample,
    before: Setpoints | None,
    commands: Setpoints,
) -> None:
    """Check the commands of one SYNC against the limits.

    A joint that enters position mode, or whose drive has no power yet, must have its measured position as target; every
    later change of target is checked as a motion. Raises `CommandRefused` if a command is outside the limits,
    `StopLatched` if STOP was pressed since the commands were made.
    """
    if before is commands:
        return
    for joint, (limit, mode, command) in enumerate(zip(limits, modes, commands, strict=True)):
        last = None if before is None else before[joint]
        if command.mode != CYCLIC_POSITION or command == last:
            continue
        if command_of(command.controlword) is not Command.ENABLE_OPERATION:
            continue  # no other controlword causes motion
        target, measured = command.target_counts, sample.counts[joint]
        drive = state_of(sample.statuswords[joint])
        holds = last is not None and last.mode == CYCLIC_POSITION and drive in CLOSED_LOOP_STATES
        previous = last.target_counts if last is not None and holds else None
        entering = previous is None or mode is not JointMode.POSITION
        if previous is None and limit.joint in sample.missing:
            raise CommandRefused(
                f"joint {limit.joint} cannot hold its position: its drive did not answer the last SYNC"
            )
        if target == previous or (entering and abs(target - measured) <= limit.max_step_counts):
            continue
        if previous is None:
            refusal = refuse_target(limit, target, measured)
        elif stopped:
            raise StopLatched(f"joint {limit.joint}: STOP is latched")
        else:
            refusal = refuse_command(
                limit.joint, in_control=in_control, drive=drive, mode=mode
            ) or refuse_target(limit, target, previous)
        if refusal:
            raise CommandRefused(refusal)


def admit_move(
    limits: Sequence[JointLimits],
    scales: Sequence[JointScale],
    joints: Sequence[JointState],
    targets_rad: Mapping[int, float],
    speed_rad_per_s: float,
    *,
    in_control: bool,
) -> None:
    """Check a whole move: `CommandRefused` if a limit forbids it, `ValueError` for an unknown joint."""
    for joint, target_rad in targets_rad.items():
        if not 1 <= joint <= len(limits):
            raise ValueError(f"there is no joint {joint}")
        limit, state = limits[joint - 1], joints[joint - 1]
        target = scales[joint - 1].counts_of(target_rad)
        if refusal := refuse_command(
            joint, in_control=in_control, drive=state.drive, mode=state.mode
        ) or refuse_move(limit, target, speed_rad_per_s):
            raise CommandRefused(refusal)


def not_enabled(sample: Sample) -> DriveNotReady | None:
    """Return the error for the first drive that is not in *operation enabled*; None if all are."""
    for joint, status in enumerate(sample.statuswords, 1):
        if (state := state_of(status)) is not DriveState.OPERATION_ENABLED:
            return DriveNotReady(joint, state.value, conditions=conditions(status))
    return None
