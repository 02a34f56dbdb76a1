"""Objects of the virtual nodes, read and written by a raw peer with the numbers of the standards."""

import struct

import pytest
from canopen import SdoAbortedError


def test_joint_objects_have_the_values_of_its_axis(arm):
    """The objects that an operator does not compare with the arm file when it connects."""
    assert arm.peer.unsigned(1, 0x607F) == 18_000
    assert arm.peer.unsigned(1, 0x6076) == 100_000
    assert arm.peer.unsigned(1, 0x6502) == 1 << 7 | 1 << 9
    assert arm.peer.signed(1, 0x605A) == 6


@pytest.mark.parametrize(
    ("node", "index", "sub", "data", "code"),
    [
        (1, 0x6040, 0, b"\x06", 0x06070010),
        (1, 0x6041, 0, b"\x06\x00", 0x06010002),
        (1, 0x6064, 0, bytes(4), 0x06010002),
        (1, 0x607C, 0, bytes(4), 0x06010002),
        (1, 0x1017, 0, b"\x0a\x00", 0x06010002),
        (1, 0x6071, 0, b"\x01\x00", 0x06090031),
        (1, 0x6071, 0, b"\xff\xff", 0x06090032),
        (1, 0x5000, 0, b"\x00", 0x06020000),
        (1, 0x6040, 1, bytes(2), 0x06090011),
        (1, 0x607D, 3, bytes(4), 0x06090011),
        (1, 0x1003, 0, b"\x01", 0x06090030),
        (16, 0x2002, 0, b"\x00", 0x06090032),
        (16, 0x2002, 0, b"\x04", 0x06090031),
        (16, 0x2010, 0, b"\x80\x00\x00\x00", 0x06090031),
        # Read:
        (1, 0x5000, 0, None, 0x06020000),
        (1, 0x1018, 9, None, 0x06090011),
        (1, 0x1003, 1, None, 0x08000024),
        (16, 0x2002, 0, None, 0x06010001),
        (16, 0x2000, 0, None, 0x08000024),
        (16, 0x2004, 0, None, 0x08000024),
    ],
)
def test_invalid_access_is_aborted_with_its_code(arm, node, index, sub, data, code):
    entry = node, index, sub
    with pytest.raises(SdoAbortedError) as abort:
        arm.peer.read(*entry) if data is None else arm.peer.write(*entry, data)
    assert abort.value.code == code


def test_drive_can_be_enabled_and_moved_by_sdo(arm):
    arm.peer.start()
    arm.peer.take_control()
    arm.peer.write(2, 0x6060, 0, b"\x08")
    for word in (0x06, 0x07, 0x0F):
        arm.peer.write(2, 0x6040, 0, struct.pack("<H", word))
    for _ in range(4):
        target = arm.peer.sync()[1][1] - 7
    arm.peer.write(2, 0x607A, 0, struct.pack("<i", target))
    assert arm.peer.signed(2, 0x607A) == target
    assert arm.peer.sync()[1][1] == target
    assert arm.peer.signed(2, 0x6064) == target
