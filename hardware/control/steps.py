"""What the arm does SYNC by SYNC: enable, change modes, move, hold, reset. Knows no bus and no thread.

Each function is a generator in the sense of `hardware.control.tasks.Steps`: it yields the commands of
the next SYNC, is sent the sample of that SYNC, and returns its result. Whatever ends one early, the
joints in position mode are left at rest on the target they were given last.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from hardware.arm import ArmSnapshot, DriveState, JointMode, MoveResult, Watch
from hardware.canopen.cia402 import (
    CONTROLWORD_ENABLE_OPERATION,
    StatusBit,
    TargetState,
    next_controlword,
    reached,
    state_of,
)
from hardware.canopen.cyclic import Sample, Setpoint, Setpoints
from hardware.canopen.objects import CYCLIC_POSITION, MODE_CODE
from hardware.control.stop_line import StopLatch
from hardware.control.trajectory import StraightMove
from hardware.errors import (
    BusError,
    CommandRefused,
    DriveDropout,
    DriveFault,
    HardwareError,
    Stopped,
)
from hardware.scale import JointScale

INCOMPLETE_SYNCS = 200
"""SYNCs in a row that some joint did not answer as it should, after which a move is given up."""

TRANSITION_SYNCS = 50
"""A drive may take this many SYNCs from one end of its state machine to the other."""


class LoopView(Protocol):
    """What steps see of the control loop."""

    commands: Setpoints | None
    latch: StopLatch
    moving: bool

    @property
    def sample(self) -> Sample:
        """The latest sample."""
        ...

    def alarm(self) -> HardwareError | None:
        """Why the steps should end, if anything."""
        ...


def follows_command(statusword: int) -> bool:
    """Whether the drive is in position mode and follows its target (bit 12)."""
    return bool(statusword & StatusBit.FOLLOWS_COMMAND)


def not_following(sample: Sample, modes: Sequence[JointMode]) -> int | None:
    """The first joint asked for position mode whose enabled drive does not say that it follows; None if all do."""
    for joint, (status, mode) in enumerate(zip(sample.statuswords, modes, strict=True), 1):
        enabled = state_of(status) is DriveState.OPERATION_ENABLED
        if mode is JointMode.POSITION and enabled and not follows_command(status):
            return joint
    return None


def look_until_whole(loop: LoopView) -> Generator[Setpoints | None, Sample, Sample]:
    """Exchange SYNCs without a command until one was answered by every joint; at least two."""
    sample = loop.sample
    for seen in range(INCOMPLETE_SYNCS):
        sample = yield None
        raise_alarm(loop)
        if seen and sample.complete:
            return sample
    raise incomplete_samples(sample)


def drive_to(
    loop: LoopView, wish: TargetState
) -> Generator[Setpoints | None, Sample, tuple[int, ...]]:
    """Bring all drives to a state, in position mode, the target being where each one is now.

    One that was there is told to stay, and no more: whether it does is the alarm's affair.

    Returns
    -------
    Joints that did not get there, in time or because they are in a fault.
    """
    sample = yield None
    targets = sample.counts
    words, there = [0] * len(targets), [False] * len(targets)
    for _ in range(TRANSITION_SYNCS):
        raise_alarm(loop)
        words = [
            word if stays else _next_controlword(status, wish, word)
            for status, word, stays in zip(sample.statuswords, words, there, strict=True)
        ]
        there = [
            stays or reached(state_of(status), wish)
            for status, stays in zip(sample.statuswords, there, strict=True)
        ]
        sample = yield tuple(
            Setpoint(word, target, CYCLIC_POSITION)
            for word, target in zip(words, targets, strict=True)
        )
        if not _lagging(sample, wish):
            break
    return _lagging(sample, wish)


def reset(
    loop: LoopView, clear: Callable[[], None], *, press: object | None
) -> Generator[Setpoints | None, Sample, tuple[int, ...]]:
    """Release the STOP latch and clear drive faults; the drives end disabled.

    `clear` forgets the emergencies known so far; `press` is the STOP to be lifted. Returns the
    joints whose fault stays.

    Raises
    ------
    Stopped
        If STOP was pressed after `press`; nothing was changed.
    """
    if not loop.latch.release(press):
        raise Stopped("STOP was pressed again before it was reset: reset it once more")
    loop.commands = None  # the commands from before must not go out again
    clear()
    return (yield from drive_to(loop, TargetState.FAULT_CLEARED))


def change_modes(
    loop: LoopView, modes: Sequence[JointMode], *, syncs: int
) -> Generator[Setpoints | None, Sample, None]:
    """Ask for one mode per joint, and give the drives `syncs` SYNCs to follow.

    A joint that enters position mode is given the position it has until its drive says that it
    follows; one that is in position mode already keeps its target.
    """
    sample = yield None
    wanted = [MODE_CODE[mode] for mode in modes]
    entering = [
        command.mode != CYCLIC_POSITION and mode == CYCLIC_POSITION
        for command, mode in zip(_given(loop), wanted, strict=True)
    ]
    for _ in range(syncs):
        raise_alarm(loop)
        commands = list(_given(loop))
        for at, (command, mode) in enumerate(zip(commands, wanted, strict=True)):
            if mode != CYCLIC_POSITION:
                commands[at] = Setpoint(CONTROLWORD_ENABLE_OPERATION, sample.counts[at], mode)
            elif entering[at] and (
                # In free mode bit 12 may be set as well: there it is the torque that is followed.
                command.mode != mode or not follows_command(sample.statuswords[at])
            ):
                commands[at] = replace(command, target_counts=sample.counts[at], mode=mode)
        sample = yield tuple(commands)
    raise_alarm(loop)


def move(
    loop: LoopView,
    targets_rad: Mapping[int, float],
    scales: Sequence[JointScale],
    *,
    speed_rad_per_s: float,
    acceleration_rad_per_s2: float,
    period_s: float,
    watch: Watch | None,
    snapshot: Callable[[], ArmSnapshot],
) -> Generator[Setpoints | None, Sample, MoveResult]:
    """Move joints in step along a straight line in joint space.

    A watch's sentence ends the move with that reason. Any alarm but STOP first brings the joints to
    rest along the line and is then raised, also one that comes while they are coming to rest; after
    a tripped drive all others hold where they are.
    """
    sample = yield None
    raise_alarm(loop)
    joints = sorted(targets_rad)
    commands = _given(loop)
    path = StraightMove(
        np.array([scales[j - 1].to_rad(commands[j - 1].target_counts) for j in joints]),
        np.array([targets_rad[j] for j in joints]),
        speed_rad_per_s=speed_rad_per_s,
        acceleration_rad_per_s2=acceleration_rad_per_s2,
        period_s=period_s,
    )
    reason, first, incomplete = "", sample.sync_count, 0
    ending: Exception | None = None
    # Whatever turns out to be the reason, the others hold once a drive was not as it was put.
    faulted = False
    loop.moving = True
    try:
        while not path.finished:
            if sample.complete or path.braking:
                point = path.next().tolist()
                for joint, angle in zip(joints, point, strict=True):
                    if _enabled(sample, joint):  # a tripped drive is not led any further
                        target = scales[joint - 1].to_counts(angle)
                        commands = _with_target(commands, joint, target)
            sample = yield commands
            if loop.latch.latched:
                raise_alarm(loop)
            incomplete = 0 if sample.complete else incomplete + 1
            ending = _more_urgent(loop.alarm() or _not_enabled(sample), ending)
            faulted = faulted or isinstance(ending, DriveFault)
            if ending is None and incomplete >= INCOMPLETE_SYNCS:
                ending = incomplete_samples(sample)
            if isinstance(ending, Stopped):
                raise ending
            if ending is None and watch is not None and not path.braking:
                try:
                    reason = watch(snapshot()) or ""
                except Exception as error:  # noqa: BLE001 - raised again when the arm is at rest
                    ending = error
            if reason or ending is not None:
                path.brake()
    finally:
        loop.moving = False
    if faulted:
        yield from hold_where_it_is(loop)
    if ending is not None:
        raise ending
    positions = [scale.to_rad(counts) for scale, counts in zip(scales, sample.counts, strict=True)]
    return MoveResult(
        reached=not reason,
        reason=reason,
        positions_rad=np.array(positions),
        syncs=sample.sync_count - first,
    )


def incomplete_samples(sample: Sample) -> BusError:
    """Why nothing goes on where hardly any SYNC is answered by all joints once."""
    named = ", ".join(map(str, sample.missing)) or "now one, now another"
    return BusError(
        "Hardly any SYNC is answered by every joint, and once: the last one was not by joint "
        f"{named}. Look at the cable, the bus load and that drive, then go on."
    )


def hold_where_it_is(loop: LoopView) -> Generator[Setpoints | None, Sample, None]:
    """All joints to position mode now: free ones where they are, the others on their target."""
    sample = yield None
    yield tuple(
        command
        if command.mode == CYCLIC_POSITION
        else replace(command, target_counts=counts, mode=CYCLIC_POSITION)
        for command, counts in zip(_given(loop), sample.counts, strict=True)
    )


def raise_alarm(loop: LoopView) -> None:
    """Raise what should end the steps, if anything."""
    found = loop.alarm()
    if found is not None:
        raise found


def _given(loop: LoopView) -> Setpoints:
    """Return the commands sent last."""
    if loop.commands is None:
        raise CommandRefused("the drives are not enabled: take control first")
    return loop.commands


def _enabled(sample: Sample, joint: int) -> bool:
    return state_of(sample.statuswords[joint - 1]) is DriveState.OPERATION_ENABLED


def _not_enabled(sample: Sample) -> CommandRefused | None:
    """Why the arm cannot move on: a drive is not enabled, whether its joint is led or follows freely."""
    for joint, status in enumerate(sample.statuswords, 1):
        state = state_of(status)
        if state is not DriveState.OPERATION_ENABLED:
            return CommandRefused(f"joint {joint}: the drive is in {state.value}")
    return None


def _more_urgent(found: HardwareError | None, ending: Exception | None) -> Exception | None:
    """Why a move ends: the first reason, unless what was found since asks for more than rest."""
    if ending is None or isinstance(found, Stopped):
        return found
    # A trip is often seen in the statusword first, as a drive that is not enabled: its own, or its neighbour's.
    # A node that is cut off shows so as well: its neighbours stop before it is missed.
    if isinstance(ending, DriveDropout) and isinstance(found, DriveFault | BusError):
        stopped = ending.state == DriveState.QUICK_STOP_ACTIVE.value
        own = isinstance(found, DriveFault) and found.joint == ending.joint
        return found if stopped or own else ending
    if isinstance(found, DriveFault) and not isinstance(ending, DriveFault):
        return found
    return ending


def _with_target(commands: Setpoints, joint: int, counts: int) -> Setpoints:
    changed = replace(commands[joint - 1], target_counts=counts)
    return (*commands[: joint - 1], changed, *commands[joint:])


def _lagging(sample: Sample, wish: TargetState) -> tuple[int, ...]:
    return tuple(
        joint
        for joint, status in enumerate(sample.statuswords, 1)
        if not reached(state_of(status), wish)
    )


def _next_controlword(status: int, wish: TargetState, previous: int) -> int:
    try:
        return next_controlword(status, wish, previous=previous)
    except ValueError:
        return 0
