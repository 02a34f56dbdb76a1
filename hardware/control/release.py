"""Lets go of an arm: held, drives off, and then looks whether they are. Knows no connection.

What the drives say of themselves counts, and nothing else: a drive can ignore what it is told, and what a
supervisor reports stops none.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

from hardware.canopen.cia402 import CLOSED_LOOP_STATES, TargetState, reached, state_of
from hardware.canopen.cyclic import Sample, Setpoints
from hardware.control import steps
from hardware.control.control_loop import ControlLoop
from hardware.errors import (
    BusError,
    CommandRefused,
    ControlDenied,
    DriveFault,
    DuplicateNodeId,
    HardwareError,
    NodeRestarted,
    OtherMaster,
    SensorFault,
    Stopped,
)

_DESPITE: tuple[type[HardwareError], ...] = (
    DriveFault,
    ControlDenied,
    SensorFault,
    OtherMaster,
    DuplicateNodeId,
    NodeRestarted,
    CommandRefused,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReleaseResult:
    """How an arm was left.

    Attributes
    ----------
    held
        It answered, and no drive follows a command.
    powered
        Joints whose drives close a loop all the same, those included that STOP holds.
    """

    held: bool
    powered: tuple[int, ...] = ()


def release_arm(loop: ControlLoop) -> ReleaseResult:
    """Position mode everywhere, then drives off: without a drive a joint's valve is blocked. Lifts no STOP."""
    try:
        _hold_and_disable(loop)
        sample: Sample = loop.run(_look(loop), despite=(*_DESPITE, Stopped))
    except HardwareError:  # the drives hold without us as well
        return ReleaseResult(held=False)
    return ReleaseResult(held=not _following(sample), powered=_powered(sample))


def _hold_and_disable(loop: ControlLoop) -> None:
    # A latched STOP holds the drives by itself. What a supervisor reports does not: off with them. Nor does a
    # node that is silent: the others hear.
    despite = (*_DESPITE, BusError, *(() if loop.stop_latched else (Stopped,)))
    try:
        if loop.commands is not None:  # else no drive was given any
            loop.run(steps.hold_where_it_is(loop), despite=despite)
        loop.run(steps.drive_to(loop, TargetState.DISABLED), despite=despite)
    except Stopped:  # by the latch: quick stop is what goes out from now on
        pass


def _look(loop: ControlLoop) -> Generator[Setpoints | None, Sample, Sample]:
    """Exchange SYNCs until the drives say that they are off, or stopped where STOP is latched, or too long."""
    sample = yield None
    for _ in range(steps.TRANSITION_SYNCS):
        steps.raise_alarm(loop)
        if not (_following(sample) if loop.stop_latched else _powered(sample)):
            break
        sample = yield None
    return sample


def _following(sample: Sample) -> tuple[int, ...]:
    """Joints whose drives may follow a command."""
    return tuple(
        joint
        for joint, status in enumerate(sample.statuswords, 1)
        if not reached(state_of(status), TargetState.STOPPED)
    )


def _powered(sample: Sample) -> tuple[int, ...]:
    return tuple(
        joint
        for joint, status in enumerate(sample.statuswords, 1)
        if state_of(status) in CLOSED_LOOP_STATES
    )
