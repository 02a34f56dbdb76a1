import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware.arm import DriveState
from hardware.canopen import cia402

S, T = DriveState, cia402.TargetState
DISABLE, STOP, SHUTDOWN, ON, ENABLE, RESET = (
    cia402.CONTROLWORD_DISABLE_VOLTAGE,
    cia402.CONTROLWORD_QUICK_STOP,
    cia402.CONTROLWORD_SHUTDOWN,
    cia402.CONTROLWORD_SWITCH_ON,
    cia402.CONTROLWORD_ENABLE_OPERATION,
    cia402.CONTROLWORD_FAULT_RESET,
)
ALL_FLAGS = sum(cia402.StatusBit)

# Written from the figure in the standard.
TABLE = {
    S.NOT_READY_TO_SWITCH_ON: {},
    S.SWITCH_ON_DISABLED: {SHUTDOWN: S.READY_TO_SWITCH_ON},
    S.READY_TO_SWITCH_ON: {
        ON: S.SWITCHED_ON,
        ENABLE: S.OPERATION_ENABLED,
        DISABLE: S.SWITCH_ON_DISABLED,
        STOP: S.SWITCH_ON_DISABLED,
    },
    S.SWITCHED_ON: {
        ENABLE: S.OPERATION_ENABLED,
        SHUTDOWN: S.READY_TO_SWITCH_ON,
        DISABLE: S.SWITCH_ON_DISABLED,
        STOP: S.SWITCH_ON_DISABLED,
    },
    S.OPERATION_ENABLED: {
        ON: S.SWITCHED_ON,
        SHUTDOWN: S.READY_TO_SWITCH_ON,
        DISABLE: S.SWITCH_ON_DISABLED,
        STOP: S.QUICK_STOP_ACTIVE,
    },
    S.QUICK_STOP_ACTIVE: {DISABLE: S.SWITCH_ON_DISABLED},
    S.FAULT_REACTION_ACTIVE: {},
    S.FAULT: {RESET: S.SWITCH_ON_DISABLED},
}


def test_bits_and_commands_have_the_values_of_the_standard():
    assert {bit.name: int(bit) for bit in cia402.ControlBit} == {
        "SWITCH_ON": 0x0001,
        "ENABLE_VOLTAGE": 0x0002,
        "NO_QUICK_STOP": 0x0004,
        "ENABLE_OPERATION": 0x0008,
        "FAULT_RESET": 0x0080,
    }
    assert {bit.name: int(bit) for bit in cia402.StatusBit} == {
        "VOLTAGE_ENABLED": 0x0010,
        "WARNING": 0x0080,
        "REMOTE": 0x0200,
        "INTERNAL_LIMIT": 0x0800,
        "FOLLOWS_COMMAND": 0x1000,
        "FOLLOWING_ERROR": 0x2000,
    }
    assert (DISABLE, STOP, SHUTDOWN, ON, ENABLE, RESET) == (0x00, 0x02, 0x06, 0x07, 0x0F, 0x80)
    assert frozenset({S.OPERATION_ENABLED, S.QUICK_STOP_ACTIVE}) == cia402.POWERED_STATES
    assert {S.FAULT_REACTION_ACTIVE} == cia402.CLOSED_LOOP_STATES - cia402.POWERED_STATES


def test_conditions_name_the_bits_that_explain_the_state():
    for status, bits in {
        0x0250: [], 0x0240: [4], 0x0050: [9], 0x0040: [4, 9], 0x3850: [9], 0x1237: [], 0x0237: [12],
        0x1A37: [11], 0x3237: [13], 0x2837: [11, 12, 13],
    }.items():  # fmt: skip
        text = cia402.conditions(status)
        assert [bit for bit in range(16) if f"bit {bit} = {status >> bit & 1}," in text] == bits
        assert bool(text) is bool(bits)


@pytest.mark.parametrize("state", S)
def test_reached_states_of_each_request(state):
    targets = {
        S.SWITCH_ON_DISABLED: [T.DISABLED, T.STOPPED, T.FAULT_CLEARED],
        S.OPERATION_ENABLED: [T.ENABLED],
        S.FAULT_REACTION_ACTIVE: [],
    }
    assert [t for t in T if cia402.reached(state, t)] == targets.get(state, [T.STOPPED])


@pytest.mark.parametrize("other_bits", [0x0000, 0x0001, 0x000F, 0x007F, 0xFF7F])
def test_fault_reset_needs_a_rising_edge_of_bit_7(other_bits):
    for previous, after, word in (
        (other_bits, S.SWITCH_ON_DISABLED, RESET),
        (other_bits | RESET, S.FAULT, DISABLE),
    ):
        assert cia402.after_controlword(S.FAULT, RESET, previous) is after
        assert cia402.after_controlword(S.FAULT, RESET | ENABLE, previous) is after
        status = cia402.statusword(S.FAULT)
        assert cia402.next_controlword(status, T.FAULT_CLEARED, previous=previous) == word


@pytest.mark.parametrize("word", [DISABLE, STOP, SHUTDOWN, ON, ENABLE, RESET], ids=hex)
@pytest.mark.parametrize("state", S)
def test_state_after_each_command(state, word):
    assert cia402.after_controlword(state, word, 0) is TABLE[state].get(word, state)


@pytest.mark.parametrize(
    ("state", "words", "after"),
    [
        # Without enable voltage any other bit means disable, without the quick stop bit it means stop.
        (S.OPERATION_ENABLED, (0x0001, 0x0004, 0x000D, 0x0105, 0xFF01), S.SWITCH_ON_DISABLED),
        (S.OPERATION_ENABLED, (0x0002, 0x0003, 0x000A, 0x000B), S.QUICK_STOP_ACTIVE),
        # Only bit 3 enables operation; higher bits change nothing.
        (S.READY_TO_SWITCH_ON, (0x0017, 0x0107, 0xFF07), S.SWITCHED_ON),
        (S.SWITCHED_ON, (0x001F, 0x010F, 0x800F), S.OPERATION_ENABLED),
    ],
)
def test_other_bits_of_a_controlword_do_not_change_its_command(state, words, after):
    assert {cia402.after_controlword(state, word, 0) for word in words} == {after}


AFTER_EVENT = {
    cia402.DriveEvent.INITIALISED: {S.NOT_READY_TO_SWITCH_ON: S.SWITCH_ON_DISABLED},
    cia402.DriveEvent.FAULT_REACTION_DONE: {S.FAULT_REACTION_ACTIVE: S.FAULT},
    cia402.DriveEvent.QUICK_STOP: {S.OPERATION_ENABLED: S.QUICK_STOP_ACTIVE},
    cia402.DriveEvent.FAULT: dict.fromkeys(set(S) - {S.FAULT}, S.FAULT_REACTION_ACTIVE),
}


@pytest.mark.parametrize("event", cia402.DriveEvent)
@pytest.mark.parametrize("state", S)
def test_state_after_each_event(state, event):
    assert cia402.after_event(state, event) is AFTER_EVENT[event].get(state, state)


def test_only_upward_transitions_raise_power():
    upward = {
        (before, after)
        for before in S
        for after in S
        if after in TABLE[before].values() and cia402.raises_power(before, after)
    }
    assert upward == {
        (S.SWITCH_ON_DISABLED, S.READY_TO_SWITCH_ON),
        (S.READY_TO_SWITCH_ON, S.SWITCHED_ON),
        (S.READY_TO_SWITCH_ON, S.OPERATION_ENABLED),
        (S.SWITCHED_ON, S.OPERATION_ENABLED),
    }


# Statuswords as CiA 402 prints them: x is 0 or 1.
@pytest.mark.parametrize(
    ("pattern", "state"),
    [
        ("x0xx0000", S.NOT_READY_TO_SWITCH_ON),
        ("x1xx0000", S.SWITCH_ON_DISABLED),
        ("x01x0001", S.READY_TO_SWITCH_ON),
        ("x01x0011", S.SWITCHED_ON),
        ("x01x0111", S.OPERATION_ENABLED),
        ("x00x0111", S.QUICK_STOP_ACTIVE),
        ("x0xx1111", S.FAULT_REACTION_ACTIVE),
        ("x0xx1000", S.FAULT),
    ],
)
def test_statuswords_of_the_standard_are_decoded(pattern, state):
    words = [
        word
        for word in range(256)
        if all(bit in ("x", digit) for bit, digit in zip(pattern, f"{word:08b}", strict=True))
    ]
    assert words
    for word in words:
        assert cia402.state_of(word | 0xFF00) is cia402.state_of(word) is state
    if state is not S.NOT_READY_TO_SWITCH_ON:  # which stands for words without a state too
        for high in (0x0000, 0xFF00):
            assert [word for word in range(256) if cia402.state_of(word | high) is state] == words


@given(st.sampled_from(list(S)), st.sampled_from([0, ALL_FLAGS, *cia402.StatusBit]))
def test_statusword_is_decoded_as_encoded(state, flags):
    word = cia402.statusword(state, flags)
    assert cia402.state_of(word) is state
    assert word & ALL_FLAGS == flags
    assert cia402.statusword(state, word) == word


@pytest.mark.parametrize(
    ("target", "words"),
    [
        (T.ENABLED, {0x40: SHUTDOWN, 0x21: ON, 0x23: ENABLE, 0x27: ENABLE}),
        (T.ENABLED, {0x07: DISABLE, 0x08: DISABLE}),
        (T.ENABLED, {0x02: DISABLE, 0x61: DISABLE}),  # without a decodable state
        (T.DISABLED, {0x08: DISABLE, 0x27: DISABLE}),
        (T.FAULT_CLEARED, {0x08: RESET}),
        (T.STOPPED, {0x27: STOP}),
    ],
)
def test_next_controlword_towards_target(target, words):
    assert {status: cia402.next_controlword(status, target) for status in words} == words


@pytest.mark.parametrize("target", T)
@pytest.mark.parametrize("state", S)
def test_next_controlwords_reach_the_target_in_six_steps(state, target):
    word = cia402.CONTROLWORD_FAULT_RESET  # the worst previous word
    faulty = state in (S.FAULT, S.FAULT_REACTION_ACTIVE)
    state = cia402.after_event(
        cia402.after_event(state, cia402.DriveEvent.INITIALISED),
        cia402.DriveEvent.FAULT_REACTION_DONE,
    )
    for _ in range(6):
        previous, word = (
            word,
            cia402.next_controlword(cia402.statusword(state), target, previous=word),
        )
        state = cia402.after_controlword(state, word, previous)
    if faulty and target in (T.DISABLED, T.ENABLED):
        assert state is S.FAULT
    else:
        assert cia402.reached(state, target)


@pytest.mark.parametrize("previous", [0, RESET])
@pytest.mark.parametrize("state", S)
def test_stop_and_fault_end_only_in_switch_on_disabled(state, previous):
    after = {cia402.after_controlword(state, word, previous) for word in range(256)}
    if state in (S.QUICK_STOP_ACTIVE, S.FAULT, S.FAULT_REACTION_ACTIVE):
        assert after <= {state, S.SWITCH_ON_DISABLED}
    for target in set(T) - {T.ENABLED}:
        word = cia402.next_controlword(
            cia402.statusword(state, ALL_FLAGS), target, previous=previous
        )
        assert not cia402.raises_power(state, cia402.after_controlword(state, word, previous))
