"""Parameter documents over the bus: stage, read back, commit, roll back, and everything that may be wrong."""

import hashlib
import threading
from collections.abc import Callable

import pytest

from hardware.virtual.faults import inject
from hardware.virtual.parameter_store import (
    Disk,
    FolderDisk,
    ParameterStore,
    ValidatedParameters,
    refuse_documents,
)
from hardware.virtual.supervisor_node import ArmLabel
from tests.oracles.raw_can import RawAbort
from tests.oracles.virtual_rig import Rig, parse, rig

STAGE, COMMIT, ROLL_BACK = b"\x01", b"\x02", b"\x03"
OFFSETS = (12, -7, 0, 18_000, -18_000, 3, -4)
OTHER = (1, 2, 3, 4, 5, 6, 7)


def document(offsets: tuple[int, ...] = OFFSETS, serial: str = "SDA-0007") -> bytes:
    return "\n".join([serial, *map(str, offsets)]).encode()


@pytest.fixture
def arm():
    with rig() as made:
        made.peer.take_control()
        yield made


def offsets(arm: Rig) -> tuple[int, ...]:
    return tuple(arm.peer.signed(joint, 0x607C) for joint in range(1, 8))


def slots(arm: Rig) -> list[int]:
    return [arm.peer.unsigned(16, 0x2003, sub) for sub in (1, 2, 3, 4)]


def order(arm: Rig, command: bytes) -> int | None:
    try:
        arm.peer.write(16, 0x2002, 0, command)
    except RawAbort as refused:
        return refused.code
    return None


def upload(arm: Rig, data: bytes) -> None:
    arm.peer.write(16, 0x2000, 0, data)
    assert order(arm, STAGE) is None
    assert order(arm, COMMIT) is None


def held(arm: Rig) -> bytes | int:
    """What 2000h reads, or the abort code."""
    try:
        return arm.peer.read(16, 0x2000)
    except RawAbort as refused:
        return refused.code


def refused_by(validate: Callable[[bytes], ValidatedParameters]) -> bytes:
    """Why a controller with this schema refuses a document."""
    with rig(validate=validate) as arm:
        arm.peer.take_control()
        arm.peer.write(16, 0x2000, 0, document())
        assert order(arm, STAGE) == 0x08000020
        return arm.peer.read(16, 0x2004)


def test_stage_read_back_commit(arm):
    data = document() + b"\n" * 4000
    arm.peer.write(16, 0x2000, 0, data)
    assert slots(arm) == [0, 0, 0, 0]
    assert order(arm, STAGE) is None
    assert slots(arm) == [0, 0, 0, 1]
    assert offsets(arm) == (0,) * 7
    assert held(arm) == data
    assert arm.peer.read(16, 0x2001, 1) == hashlib.sha256(data).digest()
    assert arm.peer.unsigned(16, 0x2001, 2) == len(data)
    assert order(arm, COMMIT) is None
    assert slots(arm) == [1, 1, 0, 0]
    assert offsets(arm) == OFFSETS
    assert held(arm) == data


def test_the_second_document_goes_to_the_other_slot_and_back(arm):
    upload(arm, document())
    upload(arm, document(OTHER))
    assert slots(arm) == [2, 1, 1, 0]
    assert offsets(arm) == OTHER
    assert order(arm, ROLL_BACK) is None
    assert slots(arm) == [1, 1, 1, 0]
    assert offsets(arm) == OFFSETS
    assert held(arm) == document()


def test_roll_back_drops_what_was_staged_first(arm):
    upload(arm, document())
    arm.peer.write(16, 0x2000, 0, document(OTHER))
    assert order(arm, STAGE) is None
    assert held(arm) == document(OTHER)
    assert order(arm, ROLL_BACK) is None
    assert held(arm) == document()
    assert order(arm, COMMIT) == 0x08000022
    assert offsets(arm) == OFFSETS


@pytest.mark.parametrize(
    "data",
    [
        b"\xff\xfe",
        document(serial="SDA-0008"),
        document(OFFSETS[:6]),
        document((18_001, *OFFSETS[1:])),
        document((-18_001, *OFFSETS[1:])),
        document((*OFFSETS[:6], 5121)),
    ],
)
def test_invalid_document_is_refused_without_effect(arm, data, approve):
    upload(arm, document(OTHER))
    arm.peer.write(16, 0x2000, 0, data)
    assert order(arm, STAGE) == 0x08000020
    approve(arm.peer.read(16, 0x2004).decode())
    assert order(arm, COMMIT) == 0x08000022
    assert slots(arm) == [1, 1, 0, 0]
    assert offsets(arm) == OTHER
    assert held(arm) == document(OTHER)


@pytest.mark.parametrize("angle", [float("nan"), float("inf"), 2.1 / 5729.578])
def test_angles_must_be_finite_and_match_counts(angle, approve):
    def validate(data: bytes) -> ValidatedParameters:
        return ValidatedParameters(
            arm_serial="SDA-0007",
            home_offset_counts=(0,) * 7,
            theta_off_rad=(angle, 0, 0, 0, 0, 0, 0),
        )

    approve(refused_by(validate).decode())


def test_words_that_are_no_ascii_are_escaped():
    def validate(data: bytes) -> ValidatedParameters:
        raise ValueError("Straße")

    assert refused_by(validate) == b"Stra\\xdfe"


def test_without_the_token_nothing_is_taken(arm):
    arm.peer.write(16, 0x2010, 0, bytes(4))
    with pytest.raises(RawAbort) as refused:
        arm.peer.write(16, 0x2000, 0, document())
    assert refused.value.code == 0x08000021
    assert order(arm, STAGE) == 0x08000021
    assert b"token" in arm.peer.read(16, 0x2004)


@pytest.mark.parametrize("staged", [False, True])
def test_what_was_not_committed_goes_with_the_token(arm, staged):
    arm.peer.write(16, 0x2000, 0, document())
    if staged:
        assert order(arm, STAGE) is None
    arm.peer.write(16, 0x2010, 0, bytes(4))
    arm.peer.take_control()
    assert held(arm) == 0x08000024
    assert order(arm, COMMIT) == 0x08000022
    assert slots(arm) == [0, 0, 0, 0]


def test_commands_out_of_order(arm):
    assert order(arm, STAGE) == 0x08000022
    assert order(arm, COMMIT) == 0x08000022
    assert order(arm, ROLL_BACK) == 0x08000022
    arm.peer.write(16, 0x2000, 0, document())
    assert order(arm, COMMIT) == 0x08000022
    assert b"nothing is staged" in arm.peer.read(16, 0x2004)


def test_a_new_document_takes_the_place_of_a_staged_one(arm):
    arm.peer.write(16, 0x2000, 0, document())
    assert order(arm, STAGE) is None
    arm.peer.write(16, 0x2000, 0, document(OTHER))
    assert slots(arm)[3] == 0
    assert order(arm, COMMIT) == 0x08000022


def test_a_controller_without_a_schema_refuses_every_document():
    assert b"without a parameter schema" in refused_by(refuse_documents)


def test_restarting_brings_the_committed_offsets_back(tmp_path):
    for first in (True, False):
        with rig(store=ParameterStore(FolderDisk(tmp_path))) as arm:
            if first:
                arm.peer.take_control()
                upload(arm, document())
                arm.peer.write(16, 0x2000, 0, document(OTHER))
                assert order(arm, STAGE) is None
            assert offsets(arm) == OFFSETS
    with rig(store=ParameterStore(FolderDisk(tmp_path))) as arm:
        inject(arm.controller, "restart", 1)
        arm.peer.wait_for(lambda number, data: (number, data) == (0x710, b"\0"))
        assert offsets(arm) == OFFSETS
        assert slots(arm) == [1, 1, 0, 0]


def test_another_arms_controller_does_not_use_the_document(tmp_path):
    with rig(store=ParameterStore(FolderDisk(tmp_path))) as arm:
        arm.peer.take_control()
        upload(arm, document())
    with rig(
        store=ParameterStore(FolderDisk(tmp_path)),
        arm=ArmLabel(model="test_arm", serial_number="SDA-0009"),
    ) as arm:
        assert offsets(arm) == (0,) * 7
        assert b"active document not used" in arm.peer.read(16, 0x2004)


def break_the_schema() -> None:
    def broken(data: bytes) -> ValidatedParameters:
        raise KeyError("a mistake in the schema's own code")

    with rig(validate=broken) as arm:
        arm.peer.take_control()
        for _ in range(2):  # the second command is answered as well
            arm.peer.write(16, 0x2000, 0, document())
            assert order(arm, STAGE) == 0x08000000
            assert b"the controller failed" in arm.peer.read(16, 0x2004)
        assert slots(arm)[0] == 0


def test_a_mistake_in_the_schema_is_answered_and_not_kept_quiet():
    with pytest.raises(KeyError, match="mistake"):
        break_the_schema()


class FullDisk(Disk):
    def write(self, name: str, data: bytes) -> None:
        raise OSError(28, "No space left on device")


def test_a_full_disk_is_said_and_changes_nothing():
    with rig(store=ParameterStore(FullDisk())) as arm:
        arm.peer.take_control()
        arm.peer.write(16, 0x2000, 0, document())
        assert order(arm, STAGE) is None
        assert order(arm, COMMIT) == 0x08000020
        assert b"No space left" in arm.peer.read(16, 0x2004)
        assert slots(arm)[0] == 0
        assert offsets(arm) == (0,) * 7


def test_the_arm_goes_on_while_a_document_is_checked_and_no_second_command_is_taken():
    checking, go_on = threading.Event(), threading.Event()

    def slow(data: bytes) -> ValidatedParameters:
        checking.set()
        assert go_on.wait(5.0)
        return parse(data)

    with rig(validate=slow) as arm:
        arm.operational()
        arm.peer.write(16, 0x2000, 0, document())
        arm.peer.send(0x610, b"\x2f\x02\x20\x00\x01\x00\x00\x00")
        assert checking.wait(5.0)
        for _ in range(20):
            arm.peer.sync()
        assert arm.peer.seen(0x590)[-1][0] == 0x20  # the answer to the document's last segment
        assert order(arm, COMMIT) == 0x08000022
        with pytest.raises(RawAbort):
            arm.peer.write(16, 0x2000, 0, document(OTHER))
        go_on.set()
        while not arm.peer.unsigned(16, 0x2003, 4):
            pass
        arm.peer.quiet()
        assert order(arm, COMMIT) is None
        assert offsets(arm) == OFFSETS
