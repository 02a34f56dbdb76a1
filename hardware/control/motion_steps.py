"""Motions and readings as steps, SYNC by SYNC: enable, change modes, move, hold, reset, settle, read.

Each function is a generator (`hardware.control.control_loop.Steps`): it yields the commands of the next SYNC, receives
the sample of that SYNC, and returns a result. If it ends early, joints in position mode stay at their last targets.

State and position of a joint in `Sample.missing` are old, so no command is derived from them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hardware import errors
from hardware.arm import DriveState, JointMode, MoveResult, Reading, Watch
from hardware.canopen import cia402
from hardware.canopen.cyclic import Sample, Setpoint, Setpoints
from hardware.command_limits import not_enabled
from hardware.control.control_loop import ControlLoop, Steps
from hardware.control.trajectory import StraightMove

if TYPE_CHECKING:
    from hardware.control.connection import Connection

INCOMPLETE_SYNCS = 200
"""Consecutive incomplete samples after which the steps end."""
STANDSTILL_SYNCS = 10
"""A move waits during incomplete samples. After this many in a row it starts again from rest; after fewer, as when
single frames are lost, it continues at its speed."""
ARRIVAL_SYNCS = 200
"""SYNCs allowed for joints to arrive after the last target of a move; failure to follow is detected sooner."""
TRANSITION_SYNCS = 50
"""SYNCs allowed for a drive to pass through its whole state machine."""
MODE_SYNCS = 5
HOLD_SYNCS = 10
"""A free joint that answers none of this many SYNCs stays free when the others are held."""


def not_following(sample: Sample, modes: Sequence[JointMode]) -> int | None:
    """Return the first enabled joint in position mode that does not report bit 12 (follows), or None."""
    for joint, (status, mode) in enumerate(zip(sample.statuswords, modes, strict=True), 1):
        enabled = cia402.state_of(status) is DriveState.OPERATION_ENABLED
        if mode is JointMode.POSITION and enabled and not status & cia402.StatusBit.FOLLOWS_COMMAND:
            return joint
    return None


def first_complete_sample(loop: ControlLoop, *, min_syncs: int = 2) -> Steps[Sample]:
    """Send no new commands; return the first complete sample after at least `min_syncs` SYNCs, or raise `BusError`."""
    sample = loop.sample
    for syncs in range(1, INCOMPLETE_SYNCS + 1):
        sample = yield None
        raise_alarm(loop)
        if syncs >= min_syncs and sample.complete:
            return sample
    raise incomplete_samples(sample)


def drive_to(
    loop: ControlLoop, target: cia402.TargetState, syncs: int = TRANSITION_SYNCS
) -> Steps[tuple[int, ...]]:
    """Bring all drives to the state `target`, in position mode; return joints still not in it after `syncs` SYNCs.

    Until a drive has power, its target position is its measured position, since the joint may sink while a brake opens.
    Once a drive has reached the state, its controlword stays the same; an alarm reports a drive that leaves the state.
    If a joint does not answer the first SYNC, its drive is commanded to switch off and keeps its mode.
    """
    if target is cia402.TargetState.ENABLED:
        sample = yield from first_complete_sample(loop, min_syncs=1)
    else:
        sample = yield None
    before = loop.commands
    commands = [
        replace(before[at], controlword=cia402.CONTROLWORD_DISABLE_VOLTAGE)
        if before is not None and at + 1 in sample.missing
        else Setpoint(cia402.CONTROLWORD_DISABLE_VOLTAGE, counts, JointMode.POSITION)
        for at, counts in enumerate(sample.counts)
    ]
    done = [False] * len(commands)
    for _ in range(syncs):
        raise_alarm(loop)
        for at, status in enumerate(sample.statuswords):
            if at + 1 in sample.missing:
                continue
            word, position = commands[at].controlword, commands[at].target_counts
            if cia402.state_of(status) not in cia402.CLOSED_LOOP_STATES:
                position = sample.counts[at]
            if not done[at]:
                word = cia402.next_controlword(status, target, previous=word)
                done[at] = cia402.reached(cia402.state_of(status), target)
            commands[at] = Setpoint(word, position, JointMode.POSITION)
        sample = yield tuple(commands)
        if not not_reached(sample, target):
            break
    return not_reached(sample, target)


def reset(loop: ControlLoop, *, press: object | None) -> Steps[tuple[int, ...]]:
    """Release STOP and clear drive faults; return the joints whose drives were not disabled in time.

    `press`: the press of STOP to release. If STOP was pressed again after it, raises `Stopped` and changes nothing.
    """
    if not loop.latch.release(press):
        raise errors.Stopped("STOP was pressed again before it was reset: reset it once more")
    loop.commands = None  # old commands must not be sent again
    loop.nodes.faults = ()
    loop.watch.reset()
    return (yield from drive_to(loop, cia402.TargetState.FAULT_CLEARED))


def change_modes(loop: ControlLoop, modes: Sequence[JointMode]) -> Steps[None]:
    """Request one mode per joint for `MODE_SYNCS` SYNCs.

    A joint that enters position mode has its measured position as target until its drive reports that it follows the
    target. A joint already in position mode keeps its target. A joint that does not answer keeps its mode.
    """
    sample = yield None
    entering = [
        command.mode is not JointMode.POSITION and mode is JointMode.POSITION
        for command, mode in zip(_last_commands(loop), modes, strict=True)
    ]
    for _ in range(MODE_SYNCS):
        raise_alarm(loop)
        commands = list(_last_commands(loop))
        for at, (command, mode) in enumerate(zip(commands, modes, strict=True)):
            if at + 1 in sample.missing:
                continue
            if mode is not JointMode.POSITION:
                commands[at] = Setpoint(
                    cia402.CONTROLWORD_ENABLE_OPERATION, sample.counts[at], mode
                )
            elif entering[at] and (
                # In free mode bit 12 may mean that the torque is followed.
                command.mode is not mode
                or not sample.statuswords[at] & cia402.StatusBit.FOLLOWS_COMMAND
            ):
                commands[at] = replace(command, target_counts=sample.counts[at], mode=mode)
        sample = yield tuple(commands)
    raise_alarm(loop)


def move(
    link: Connection, targets_rad: Mapping[int, float], speed_rad_per_s: float, watch: Watch | None
) -> Steps[MoveResult]:
    """Move joints along a straight line in joint space, so that all arrive together.

    While samples are incomplete, the targets stay the same. After the last target, the move waits for the joints to
    arrive. A non-empty text from `watch` ends the move and becomes `MoveResult.reason`. An alarm other than STOP is
    raised after the joints have come to rest along the line. If a drive trips, all other drives hold their positions.
    """
    loop, scales = link.loop, link.scales
    sample = yield None
    raise_alarm(loop)
    joints = sorted(targets_rad)
    commands = _last_commands(loop)
    start_rad = [scales[j - 1].to_rad(commands[j - 1].target_counts) for j in joints]
    end_rad = np.array([targets_rad[j] for j in joints])
    path = StraightMove(np.array(start_rad), end_rad, speed_rad_per_s=speed_rad_per_s)
    reason, first, incomplete = "", sample.sync_count, 0
    ending: Exception | None = None
    faulted = False  # true once a drive tripped or dropped out, whichever error is raised
    loop.moving = True
    try:
        while not path.finished:
            if sample.complete or path.braking:
                for joint, angle in zip(joints, path.next().tolist(), strict=True):
                    state = cia402.state_of(sample.statuswords[joint - 1])
                    # A tripped drive gets no further targets.
                    if state is DriveState.OPERATION_ENABLED:
                        target = scales[joint - 1].to_counts(angle)
                        changed = replace(commands[joint - 1], target_counts=target)
                        commands = (*commands[: joint - 1], changed, *commands[joint:])
            sample = yield commands
            if loop.latch.latched:
                raise_alarm(loop)
            incomplete = 0 if sample.complete else incomplete + 1
            if incomplete == STANDSTILL_SYNCS:
                path.start_from_rest()
            alarm = loop.alarm() or not_enabled(sample)
            ending = _higher_priority(alarm, ending)
            faulted = faulted or isinstance(alarm, errors.DriveFault)
            if ending is None and incomplete >= INCOMPLETE_SYNCS:
                ending = incomplete_samples(sample)
            if isinstance(ending, errors.Stopped):
                raise ending
            if ending is None and watch is not None and not path.braking:
                try:
                    reason = watch(link.snapshot()) or ""
                except Exception as error:  # noqa: BLE001 - raised again when the arm is at rest
                    ending = error
            if reason or ending is not None:
                path.brake()
    finally:
        loop.moving = False
    if faulted:
        yield from hold_all(loop)
    if ending is not None:
        raise ending
    reason = reason or (yield from _arrive(link))
    sample = loop.sample
    angles = [scale.to_rad(counts) for scale, counts in zip(scales, sample.counts, strict=True)]
    syncs = sample.sync_count - first
    return MoveResult(
        reached=not reason, reason=reason, positions_rad=np.array(angles), syncs=syncs
    )


def _arrive(link: Connection) -> Steps[str]:
    """Wait until the joints in position mode are at their targets; return which joint is not, or "" if all are."""
    loop, commands = link.loop, _last_commands(link.loop)
    away = loop.watch.following.away(loop.sample, commands)
    for _ in range(ARRIVAL_SYNCS):
        if not away:
            break
        sample = yield None
        raise_alarm(loop)
        away = loop.watch.following.away(sample, commands)
    if not away:
        return ""
    at = away[0] - 1
    error_counts = loop.sample.counts[at] - commands[at].target_counts
    error_deg = math.degrees(error_counts / link.scales[at].counts_per_rad)
    side = "below" if error_deg < 0.0 else "above"
    return f"joint {at + 1} is {abs(error_deg):.1f} deg {side} its target"


def incomplete_samples(sample: Sample) -> errors.BusError:
    """Return the error for too many incomplete samples in a row."""
    named = ", ".join(map(str, sample.missing)) or "varying joints"
    return errors.BusError(
        "Hardly any SYNC is answered exactly once by every joint; missing in the last one: joint "
        f"{named}. Check the cable, the bus load and that drive, then go on."
    )


def hold_all(loop: ControlLoop) -> Steps[None]:
    """Put all joints into position mode: free joints at their positions, the others at their last targets.

    A joint that answers none of `HOLD_SYNCS` SYNCs stays free, because it would jump to an old position.
    """
    sample = yield None
    for _ in range(HOLD_SYNCS):
        commands = list(_last_commands(loop))
        for at, command in enumerate(commands):
            if command.mode is not JointMode.POSITION and at + 1 not in sample.missing:
                counts = sample.counts[at]
                commands[at] = replace(command, target_counts=counts, mode=JointMode.POSITION)
        sample = yield tuple(commands)
        held = all(command.mode is JointMode.POSITION for command in commands)
        if held or loop.latch.latched:
            return


def raise_alarm(loop: ControlLoop) -> None:
    """If an alarm requires the running steps to end, raise it."""
    if (alarm := loop.alarm()) is not None:
        raise alarm


def check_alarms(loop: ControlLoop) -> Steps[None]:
    """If an alarm requires steps to end, raise it; send no commands."""
    raise_alarm(loop)
    yield from ()


def _last_commands(loop: ControlLoop) -> Setpoints:
    if loop.commands is None:
        raise errors.CommandRefused("the drives are not enabled: take control first")
    return loop.commands


def _higher_priority(
    alarm: errors.HardwareError | None, ending: Exception | None
) -> Exception | None:
    """Return the error that ends a move: `alarm` if it is first, or is STOP, or caused `ending`; otherwise `ending`."""
    if ending is None or isinstance(alarm, errors.Stopped):
        return alarm
    # The first sign of a trip or a lost node is often that its drive, or a neighbour's, is not enabled.
    tripped = isinstance(alarm, errors.DriveFault)
    if isinstance(ending, errors.DriveDropout) and (tripped or isinstance(alarm, errors.BusError)):
        stopped = ending.state == DriveState.QUICK_STOP_ACTIVE.value
        own = isinstance(alarm, errors.DriveFault) and alarm.joint == ending.joint
        return alarm if stopped or own else ending
    # What another program commanded is the cause of a later trip.
    explained = isinstance(ending, errors.DriveFault | errors.OtherMaster)
    return alarm if tripped and not explained else ending


def not_reached(sample: Sample, target: cia402.TargetState) -> tuple[int, ...]:
    """Return the joints whose drives do not fulfil the request `target`."""
    states = enumerate(map(cia402.state_of, sample.statuswords), 1)
    return tuple(joint for joint, state in states if not cia402.reached(state, target))


SYNCS_PER_SAMPLE, EXTRA_SYNCS = 20, 100
"""A reading may take this many SYNCs per sample, and EXTRA_SYNCS in addition, since frames may be lost."""


def settle(
    link: Connection, window: int, spread_rad: Sequence[float], timeout_syncs: int
) -> Steps[bool]:
    """Wait until each joint's last `window` complete samples span no more than `spread_rad`; false on time-out."""
    bounds = np.array([s * scale.density for s, scale in zip(spread_rad, link.scales, strict=True)])
    recent: deque[tuple[int, ...]] = deque(maxlen=window)
    for _ in range(timeout_syncs):
        sample = yield None
        raise_alarm(link.loop)
        if sample.complete:
            recent.append(sample.counts)
            if len(recent) == window and np.all(np.ptp(np.array(recent), axis=0) <= bounds):
                return True
    return False


def capture(link: Connection, samples: int) -> Steps[Reading]:
    """Average complete samples, each with all joints latched on one SYNC; `BusError` if too few are complete."""
    scales = link.scales
    rows: list[tuple[int, ...]] = []
    first = 0
    for _ in range(EXTRA_SYNCS + SYNCS_PER_SAMPLE * samples):
        if len(rows) == samples:
            break
        sample = yield None
        raise_alarm(link.loop)
        if sample.complete:
            first = first or sample.sync_count
            rows.append(sample.counts)
    if len(rows) < samples:
        raise incomplete_samples(sample)
    counts = np.array(rows, dtype=np.float64)
    mean = counts.mean(axis=0)
    spread = counts.std(axis=0, ddof=1) if samples > 1 else np.zeros(len(scales))
    return Reading(
        mean_counts=mean,
        mean_rad=np.array([s.to_rad(m) for s, m in zip(scales, mean.tolist(), strict=True)]),
        sd_rad=spread / [scale.density for scale in scales],
        samples=samples,
        first_sync=first,
    )
