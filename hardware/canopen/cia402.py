"""The CiA 402 drive state machine as pure functions, for the drive and for its operator.

For the drive, they return the next state after a controlword or event, and the statusword of a state. For the operator,
they return the next controlword for a target state. After quick stop (605Ah = 6) a drive stays in *quick stop active*.

Two choices make a delayed frame harmless. Transition 16 (*quick stop active* to *operation enabled*) is not
implemented, so that a command sent before STOP cannot restart the arm. The standard advises against this transition.
Only a rising edge of bit 7 resets a fault.
"""

from enum import Enum, IntEnum
from functools import lru_cache
from types import MappingProxyType
from typing import Final

from hardware.arm import DriveState

_S = DriveState


class ControlBit(IntEnum):
    """Bits of 6040h."""

    SWITCH_ON = 1 << 0
    ENABLE_VOLTAGE = 1 << 1
    NO_QUICK_STOP = 1 << 2
    ENABLE_OPERATION = 1 << 3
    FAULT_RESET = 1 << 7


class StatusBit(IntEnum):
    """Bits of 6041h other than the bits that code the state."""

    VOLTAGE_ENABLED = 1 << 4
    WARNING = 1 << 7
    REMOTE = 1 << 9
    """The control token is held: the drive accepts commands from the bus."""
    INTERNAL_LIMIT = 1 << 11
    """The last target was refused; the drive keeps the previous one."""
    FOLLOWS_COMMAND = 1 << 12
    FOLLOWING_ERROR = 1 << 13


CONTROLWORD_DISABLE_VOLTAGE: Final = 0x0000
CONTROLWORD_QUICK_STOP: Final = 0x0002
CONTROLWORD_SHUTDOWN: Final = 0x0006
CONTROLWORD_SWITCH_ON: Final = 0x0007
CONTROLWORD_ENABLE_OPERATION: Final = 0x000F
CONTROLWORD_FAULT_RESET: Final = 0x0080

STATE_BITS: Final = MappingProxyType(
    {
        _S.NOT_READY_TO_SWITCH_ON: 0x00,
        _S.SWITCH_ON_DISABLED: 0x40,
        _S.READY_TO_SWITCH_ON: 0x21,
        _S.SWITCHED_ON: 0x23,
        _S.OPERATION_ENABLED: 0x27,
        _S.QUICK_STOP_ACTIVE: 0x07,
        _S.FAULT_REACTION_ACTIVE: 0x0F,
        _S.FAULT: 0x08,
    }
)
"""Bits 0..3, 5, 6 of 6041h in each state."""
_DECODED: Final = MappingProxyType({bits: state for state, bits in STATE_BITS.items()})


class Command(Enum):
    """Command coded in bits 0 to 3 of a controlword."""

    SHUTDOWN = "shutdown"
    SWITCH_ON = "switch on"
    """In *operation enabled* the same bits mean *disable operation*."""
    ENABLE_OPERATION = "enable operation"
    DISABLE_VOLTAGE = "disable voltage"
    QUICK_STOP = "quick stop"


class DriveEvent(Enum):
    """Event that changes a drive's state without a controlword."""

    INITIALISED = "initialised"
    FAULT = "fault"
    FAULT_REACTION_DONE = "fault reaction done"
    QUICK_STOP = "quick stop"
    """Stop by the drive itself: a neighbour tripped, or the token was released."""


class TargetState(Enum):
    """State that an operator requests."""

    DISABLED = "disabled"
    """*Switch on disabled*; a fault stays a fault."""
    ENABLED = "enabled"
    """*Operation enabled*; a fault is not reset."""
    STOPPED = "stopped"
    """Quick stop."""
    FAULT_CLEARED = "fault cleared"
    """*Switch on disabled*, from a fault too."""


_TRANSITIONS: Final = MappingProxyType(
    {
        (_S.SWITCH_ON_DISABLED, Command.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 2
        (_S.READY_TO_SWITCH_ON, Command.SWITCH_ON): _S.SWITCHED_ON,  # 3
        (_S.READY_TO_SWITCH_ON, Command.ENABLE_OPERATION): _S.OPERATION_ENABLED,  # 3 and 4
        (_S.READY_TO_SWITCH_ON, Command.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 7
        (_S.READY_TO_SWITCH_ON, Command.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 7
        (_S.SWITCHED_ON, Command.ENABLE_OPERATION): _S.OPERATION_ENABLED,  # 4
        (_S.SWITCHED_ON, Command.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 6
        (_S.SWITCHED_ON, Command.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 10
        (_S.SWITCHED_ON, Command.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 10
        (_S.OPERATION_ENABLED, Command.SWITCH_ON): _S.SWITCHED_ON,  # 5, disable operation
        (_S.OPERATION_ENABLED, Command.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 8
        (_S.OPERATION_ENABLED, Command.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 9
        (_S.OPERATION_ENABLED, Command.QUICK_STOP): _S.QUICK_STOP_ACTIVE,  # 11
        (_S.QUICK_STOP_ACTIVE, Command.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 12
    }
)
POWERED_STATES: Final = frozenset({_S.OPERATION_ENABLED, _S.QUICK_STOP_ACTIVE})
"""States in which the drive controls its joint."""
CLOSED_LOOP_STATES: Final = POWERED_STATES | {_S.FAULT_REACTION_ACTIVE}
"""`POWERED_STATES` and the state in which the drive brakes after a fault."""
FAULT_STATES: Final = frozenset({_S.FAULT_REACTION_ACTIVE, _S.FAULT})


def command_of(controlword: int) -> Command:
    """Return the command in bits 0 to 3; other bits are ignored."""
    if not controlword & ControlBit.ENABLE_VOLTAGE:
        return Command.DISABLE_VOLTAGE
    if not controlword & ControlBit.NO_QUICK_STOP:
        return Command.QUICK_STOP
    if not controlword & ControlBit.SWITCH_ON:
        return Command.SHUTDOWN
    if not controlword & ControlBit.ENABLE_OPERATION:
        return Command.SWITCH_ON
    return Command.ENABLE_OPERATION


def after_controlword(state: DriveState, controlword: int, previous: int) -> DriveState:
    """Return the state after `controlword`; a rising edge of bit 7 since `previous` resets a fault."""
    if controlword & ControlBit.FAULT_RESET:
        edge = not previous & ControlBit.FAULT_RESET
        return _S.SWITCH_ON_DISABLED if state is _S.FAULT and edge else state
    return _TRANSITIONS.get((state, command_of(controlword)), state)


def raises_power(before: DriveState, after: DriveState) -> bool:
    """Whether a transition is a step towards *operation enabled*; only such steps need the control token."""
    ladder = (_S.SWITCH_ON_DISABLED, _S.READY_TO_SWITCH_ON, _S.SWITCHED_ON, _S.OPERATION_ENABLED)
    return before in ladder and after in ladder and ladder.index(after) > ladder.index(before)


def after_event(state: DriveState, event: DriveEvent) -> DriveState:
    """Return the state after an event inside the drive."""
    match event:
        case DriveEvent.INITIALISED:  # 0 and 1
            return _S.SWITCH_ON_DISABLED if state is _S.NOT_READY_TO_SWITCH_ON else state
        case DriveEvent.FAULT:  # 13
            return state if state in FAULT_STATES else _S.FAULT_REACTION_ACTIVE
        case DriveEvent.FAULT_REACTION_DONE:  # 14
            return _S.FAULT if state is _S.FAULT_REACTION_ACTIVE else state
        case DriveEvent.QUICK_STOP:
            return _S.QUICK_STOP_ACTIVE if state is _S.OPERATION_ENABLED else state


def statusword(state: DriveState, flags: int = 0) -> int:
    """Return 6041h of a drive in `state`, with further bits `flags` (`StatusBit`)."""
    return STATE_BITS[state] | flags


@lru_cache(maxsize=4096)
def state_of(status: int) -> DriveState:
    """Return the state in a statusword; *not ready to switch on* if the bits encode no state."""
    # Without power, and in a fault, bit 5 (quick stop) may have either value.
    known = _DECODED.get(status & 0x6F) or _DECODED.get(status & 0x4F)
    return known or DriveState.NOT_READY_TO_SWITCH_ON


_POWER_BITS: Final = (
    (StatusBit.VOLTAGE_ENABLED, 0, "no voltage"),
    (StatusBit.REMOTE, 0, "not controlled by the bus"),
)
_SERVO_BITS: Final = (
    (StatusBit.INTERNAL_LIMIT, 1, "an internal limit is active"),
    (StatusBit.FOLLOWS_COMMAND, 0, "the target is not followed"),
    (StatusBit.FOLLOWING_ERROR, 1, "following error"),
)


def conditions(status: int) -> str:
    """Return the bits of a statusword that explain why the drive is disabled or does not follow.

    The result is text in parentheses with a leading space; it is empty if no bit is an explanation.
    """
    enabled = state_of(status) is DriveState.OPERATION_ENABLED
    stated = [
        f"bit {bit.bit_length() - 1} = {value}, {meaning}"
        for bit, value, meaning in (_SERVO_BITS if enabled else _POWER_BITS)
        if bool(status & bit) == bool(value)
    ]
    return f" (6041h: {'; '.join(stated)})" if stated else ""


def reached(state: DriveState, target: TargetState) -> bool:
    """Whether a drive in `state` fulfils the request `target`."""
    match target:
        case TargetState.ENABLED:
            return state is _S.OPERATION_ENABLED
        case TargetState.STOPPED:
            return state not in (_S.OPERATION_ENABLED, _S.FAULT_REACTION_ACTIVE)
        case TargetState.DISABLED | TargetState.FAULT_CLEARED:
            return state is _S.SWITCH_ON_DISABLED


def next_controlword(status: int, target: TargetState, *, previous: int = 0) -> int:
    """Return the controlword that takes the drive one step closer to the target state, or keeps it there.

    `status` is the drive's statusword, `previous` the controlword sent last: a fault reset needs a rising edge of
    bit 7.
    """
    state = state_of(status)
    match target:
        case TargetState.STOPPED:
            return CONTROLWORD_QUICK_STOP
        case TargetState.FAULT_CLEARED if (
            state is _S.FAULT and not previous & ControlBit.FAULT_RESET
        ):
            return CONTROLWORD_FAULT_RESET
        case TargetState.ENABLED if state is _S.SWITCH_ON_DISABLED:
            return CONTROLWORD_SHUTDOWN
        case TargetState.ENABLED if state is _S.READY_TO_SWITCH_ON:
            return CONTROLWORD_SWITCH_ON
        case TargetState.ENABLED if state in (_S.SWITCHED_ON, _S.OPERATION_ENABLED):
            return CONTROLWORD_ENABLE_OPERATION
        case _:
            return CONTROLWORD_DISABLE_VOLTAGE
