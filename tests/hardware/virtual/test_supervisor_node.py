import hashlib
import math
import threading
from collections.abc import Callable

import pytest
from canopen import SdoAbortedError

from hardware.virtual.faults import inject
from hardware.virtual.parameter_store import Disk, FolderDisk, ParameterStore, ValidatedParameters
from hardware.virtual.supervisor_node import ArmLabel
from tests.hardware.virtual.conftest import write_to_supervisor
from tests.oracles.virtual_rig import Rig, parse, rig

STAGE, COMMIT, ROLL_BACK = b"\x01", b"\x02", b"\x03"
OFFSETS = (12, -7, 0, 18_000, -18_000, 3, -4)
OTHER = (1, 2, 3, 4, 5, 6, 7)


def document(offsets: tuple[int, ...] = OFFSETS, serial: str = "SDA-0007") -> bytes:
    return "\n".join([serial, *map(str, offsets)]).encode()


@pytest.fixture
def arm(arm):
    arm.peer.take_control()
    return arm


def offsets(arm: Rig) -> tuple[int, ...]:
    return tuple(arm.peer.signed(joint, 0x607C) for joint in range(1, 8))


def slots(arm: Rig) -> list[int]:
    return [arm.peer.unsigned(16, 0x2003, sub) for sub in (1, 2, 3, 4)]


def execute(arm: Rig, command: bytes) -> int | None:
    """Abort code, None if the command was executed."""
    return write_to_supervisor(arm, 0x2002, command)


def stage(arm: Rig, data: bytes) -> None:
    arm.peer.write(16, 0x2000, 0, data)
    assert execute(arm, STAGE) is None


def upload(arm: Rig, data: bytes) -> None:
    stage(arm, data)
    assert execute(arm, COMMIT) is None


def test_document_is_staged_read_back_and_committed(arm):
    data = document() + b"\n" * 4000
    arm.peer.write(16, 0x2000, 0, data)
    assert slots(arm) == [0, 0, 0, 0]
    assert execute(arm, STAGE) is None
    assert slots(arm) == [0, 0, 0, 1]
    assert offsets(arm) == (0,) * 7
    assert arm.peer.read(16, 0x2000) == data
    assert arm.peer.read(16, 0x2001, 1) == hashlib.sha256(data).digest()
    assert arm.peer.unsigned(16, 0x2001, 2) == len(data)
    assert execute(arm, COMMIT) is None
    assert (slots(arm), offsets(arm)) == ([1, 1, 0, 0], OFFSETS)
    assert arm.peer.read(16, 0x2000) == data


def test_roll_back_drops_the_staged_document_then_switches_slots(arm):
    upload(arm, document())
    stage(arm, document(OTHER))
    assert arm.peer.read(16, 0x2000) == document(OTHER)
    assert execute(arm, ROLL_BACK) is None
    assert arm.peer.read(16, 0x2000) == document()
    assert execute(arm, COMMIT) == 0x08000022
    assert offsets(arm) == OFFSETS
    upload(arm, document(OTHER))
    assert (slots(arm), offsets(arm)) == ([2, 1, 1, 0], OTHER)
    assert execute(arm, ROLL_BACK) is None
    assert (slots(arm), offsets(arm)) == ([1, 1, 1, 0], OFFSETS)
    assert arm.peer.read(16, 0x2000) == document()


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
    assert execute(arm, STAGE) == 0x08000020
    approve(arm.peer.read(16, 0x2004).decode())
    assert execute(arm, COMMIT) == 0x08000022
    assert (slots(arm), offsets(arm)) == ([1, 1, 0, 0], OTHER)
    assert arm.peer.read(16, 0x2000) == document(OTHER)


def first_angle(rad: float) -> Callable[[bytes], ValidatedParameters]:
    """Return a schema that finds this offset of joint 1, and 0 counts."""
    return lambda _: ValidatedParameters(
        arm_serial="SDA-0007", home_offset_counts=(0,) * 7, theta_off_rad=(rad, *[0.0] * 6)
    )


def refuse(_: bytes) -> ValidatedParameters:
    raise ValueError("Straße")


@pytest.mark.parametrize(
    "validate",
    [*map(first_angle, (math.nan, math.inf, 2.1 / 5729.578)), refuse],
    ids=["nan", "inf", "other angle", "escaped"],
)
def test_refusal_by_the_schema_has_its_reason_in_ascii(validate, approve):
    with rig(validate=validate) as arm:
        arm.peer.take_control()
        arm.peer.write(16, 0x2000, 0, document())
        assert execute(arm, STAGE) == 0x08000020
        approve(arm.peer.read(16, 0x2004).decode("ascii"))


def test_document_without_token_is_refused(arm):
    arm.peer.write(16, 0x2010, 0, bytes(4))
    assert write_to_supervisor(arm, 0x2000, document()) == 0x08000021
    assert execute(arm, STAGE) == 0x08000021
    assert b"token" in arm.peer.read(16, 0x2004)


@pytest.mark.parametrize("staged", [False, True])
def test_uncommitted_document_is_dropped_with_the_token(arm, staged):
    arm.peer.write(16, 0x2000, 0, document())
    if staged:
        assert execute(arm, STAGE) is None
    arm.peer.write(16, 0x2010, 0, bytes(4))
    arm.peer.take_control()
    with pytest.raises(SdoAbortedError, match="0x08000024"):
        arm.peer.read(16, 0x2000)
    assert execute(arm, COMMIT) == 0x08000022
    assert slots(arm) == [0, 0, 0, 0]


def test_command_out_of_order_is_refused(arm):
    for command in (STAGE, COMMIT, ROLL_BACK):
        assert execute(arm, command) == 0x08000022
    stage(arm, document())
    arm.peer.write(16, 0x2000, 0, document(OTHER))  # ends the staging of the first document
    assert slots(arm)[3] == 0
    assert execute(arm, COMMIT) == 0x08000022
    assert b"nothing is staged" in arm.peer.read(16, 0x2004)


def test_committed_offsets_survive_a_restart(tmp_path):
    for first in (True, False):
        with rig(store=ParameterStore(FolderDisk(tmp_path))) as arm:
            if first:
                arm.peer.take_control()
                upload(arm, document())
                stage(arm, document(OTHER))
            assert offsets(arm) == OFFSETS
    with rig(store=ParameterStore(FolderDisk(tmp_path))) as arm:
        inject(arm.controller, "restart", 1)
        arm.peer.wait_for(lambda number, data: (number, data) == (0x710, b"\0"))
        assert (offsets(arm), slots(arm)) == (OFFSETS, [1, 1, 0, 0])


def test_document_of_another_arm_is_not_used(tmp_path):
    with rig(store=ParameterStore(FolderDisk(tmp_path))) as arm:
        arm.peer.take_control()
        upload(arm, document())
    with rig(
        store=ParameterStore(FolderDisk(tmp_path)),
        arm=ArmLabel(model="test_arm", serial_number="SDA-0009"),
    ) as arm:
        assert offsets(arm) == (0,) * 7
        assert b"active document not used" in arm.peer.read(16, 0x2004)


def test_exception_of_the_schema_is_answered_and_raised_by_close():
    def failing(data: bytes) -> ValidatedParameters:
        raise KeyError("a mistake in the schema's own code")

    with pytest.raises(KeyError, match="mistake"), rig(validate=failing) as arm:  # noqa: PT012
        arm.peer.take_control()
        for _ in range(2):  # the second command is answered too
            arm.peer.write(16, 0x2000, 0, document())
            assert execute(arm, STAGE) == 0x08000000
            assert b"the controller failed" in arm.peer.read(16, 0x2004)
        assert slots(arm)[0] == 0


class FullDisk(Disk):
    def write(self, name: str, data: bytes) -> None:
        raise OSError(28, "No space left on device")


def test_full_disk_is_reported_without_effect():
    with rig(store=ParameterStore(FullDisk())) as arm:
        arm.peer.take_control()
        stage(arm, document())
        assert execute(arm, COMMIT) == 0x08000020
        assert b"No space left" in arm.peer.read(16, 0x2004)
        assert slots(arm)[0] == 0
        assert offsets(arm) == (0,) * 7


def test_validation_does_not_block_the_arm_or_admit_a_second_command():
    checking, may_finish = threading.Event(), threading.Event()

    def slow(data: bytes) -> ValidatedParameters:
        checking.set()
        assert may_finish.wait(60.0)
        return parse(data)

    with rig(validate=slow) as arm:
        arm.operational()
        arm.peer.write(16, 0x2000, 0, document())
        arm.peer.send(0x610, b"\x2f\x02\x20\x00\x01\x00\x00\x00")
        assert checking.wait(60.0)
        for _ in range(20):
            arm.peer.sync()
        assert arm.peer.seen(0x590)[-1][0] == 0x20  # the answer to the document's last segment
        assert execute(arm, COMMIT) == 0x08000022
        assert write_to_supervisor(arm, 0x2000, document(OTHER)) is not None
        may_finish.set()
        while not arm.peer.unsigned(16, 0x2003, 4):
            pass
        arm.peer.quiet()
        assert execute(arm, COMMIT) is None
        assert offsets(arm) == OFFSETS
