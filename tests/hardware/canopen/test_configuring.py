"""PDOs of a bus profile are written into drives that have others, where it asks for it; else they are refused."""

from dataclasses import replace

import pytest

from hardware.arm import DriveState, JointMode
from hardware.canopen.bus_profile import BusProfile
from hardware.errors import (
    MappingMismatch,
    NodeMissing,
    PdoSetupFailed,
    Stopped,
    WrongArm,
    ZeroingFailed,
)
from operator_app.config.profile_file import parse_profile
from tests.hardware.fake_arm import FakeArmBus
from tests.hardware.on_fake_bus import make, wait_for
from tests.hardware.on_foreign_arm import JOINTS, PER_RAD, unconnected
from tests.oracles.foreign_arm import ForeignArm
from tests.oracles.profiles import sarcos

PROFILE = """\
schema: sarcal/profile/1
name: acme
supervisor: none
serial_number: ACME-1
pdo_maps: configured
commands:
  - {pdo: 2, cob_id: 200h + node, map: [6040h(16), 607Ah(32), 6060h(16)]}
answers:
  - {pdo: 3, cob_id: 180h + node, map: [6041h(16), 6064h(32)]}
  - {pdo: 4, cob_id: 280h + node, map: [6077h(32)]}
compared: [60C2h]
"""
NOT_VALID, ABSENT = 1 << 31, 0x06020000


def own_maps(foreign: ForeignArm) -> bool:
    """Whether all drives have what they had before anybody wrote."""
    found = [(node.held(0x1401, 1), node.held(0x1803, 1)) for node in foreign.nodes]
    return found == [(0x300 + node, 0x480 + node) for node in (1, 2, 3, 4)]


def profile(text: str = PROFILE) -> BusProfile:
    return parse_profile(text.encode(), "acme.yaml", joints=JOINTS)


def test_another_map_is_refused_or_written_as_the_profile_says(connect, foreign):
    with pytest.raises(MappingMismatch, match="node 1, 1601h") as refused:
        connect(profile(PROFILE.replace("configured", "compared")))
    assert len(refused.value.differences) == JOINTS * 6
    assert not any(node.written for node in foreign.nodes)

    arm = connect(profile())
    first = foreign.nodes[0]
    # Invalid, empty, filled, counted; and valid only when all of it stands.
    assert [w for w in first.written if w[0] in (0x1401, 0x1601)] == [
        (0x1401, 1, NOT_VALID | 0x301),
        (0x1601, 0, 0),
        (0x1601, 1, 0x60400010),
        (0x1601, 2, 0x607A0020),
        (0x1601, 3, 0x60600010),
        (0x1601, 0, 3),
        (0x1401, 1, 0x201),
    ]
    assert all(axis.word == 0 for axis in foreign.axes), "before anything is enabled"
    arm.take_control()
    arm.set_modes([JointMode.POSITION, JointMode.POSITION, JointMode.FREE, JointMode.POSITION])
    assert arm.move({2: 0.5, 4: -0.25}, speed_rad_per_s=0.9).reached
    assert arm.capture(5).mean_rad[[1, 3]] == pytest.approx([0.5, -0.25], abs=1 / PER_RAD)
    assert [axis.mode for axis in foreign.axes] == [8, 8, 10, 8]
    assert {j.drive for j in arm.snapshot().joints} == {DriveState.OPERATION_ENABLED}


def test_what_was_written_is_said_and_forgotten_by_a_reset(connect, foreign):
    arm = connect(profile())
    arm.close()
    written = [len(node.written) for node in foreign.nodes]
    again = arm.connect()  # resets their communication: they have their own maps again
    assert [len(node.written) for node in foreign.nodes] == [2 * n for n in written]
    assert len(again.configured) == JOINTS * 3
    assert again.configured[0] == (
        "joint 1 (node 1): RPDO2 is 6040h(16) + 607Ah(32) + 6060h(16) on 201h; it was "
        "607Ah(32) + 6040h(16) on 301h, type 255"
    )
    assert not any(index in (0x1010, 0x1011) for n in foreign.nodes for index, _, _ in n.written)


def test_what_is_equal_already_is_not_touched(connect, foreign):
    as_it_is = PROFILE[: PROFILE.index("commands:")] + (
        "commands:\n"
        "  - {pdo: 2, cob_id: 300h + node, map: [607Ah(32), 6040h(16)]}\n"
        "  - {pdo: 3, cob_id: 400h + node, map: [6060h(16), 6071h(16)]}\n"
        "answers:\n"
        "  - {pdo: 3, cob_id: 380h + node, map: [6077h(32), 6064h(32)]}\n"
        "  - {pdo: 4, cob_id: 480h + node, map: [6061h(16), 6041h(16)]}\n"
    )
    foreign.nodes[2].set_data(0x1803, 2, b"\xff")
    connect(profile(as_it_is))
    assert [node.written for node in foreign.nodes] == [
        [],
        [],
        [(0x1803, 1, NOT_VALID | 0x483), (0x1803, 2, 1), (0x1803, 1, 0x483)],
        [],
    ]


def test_a_pdo_that_is_in_the_way_is_switched_off(connect, foreign):
    connect(profile(PROFILE.replace("200h + node", "400h + node")))
    node = foreign.nodes[1]
    assert node.held(0x1402, 1) == NOT_VALID | 0x402
    assert node.held(0x1401, 1) == 0x402
    # Before anything else has its identifier.
    assert node.written[0] == (0x1402, 1, NOT_VALID | 0x402)


def test_fixed_maps_are_refused_by_name_and_the_rest_is_undone(connect, foreign):
    foreign.nodes[2].fixed.add(0x1A02)
    with pytest.raises(PdoSetupFailed) as refused:
        connect(profile())
    (told,) = refused.value.refusals
    assert told.startswith("joint 3 (node 3): node 3 refused 1A02h sub 0: ")
    assert "(06010002h); required map: 6041h(16) + 6064h(32)" in told
    for words in ("pdo_maps: compared", "maker's tool", "Nothing was enabled"):
        assert words in str(refused.value)
    # All drives have again what they had, as soon as they hear of it.
    wait_for(lambda: own_maps(foreign))
    assert all(axis.word == 0 for axis in foreign.axes)


def test_a_drive_that_lacks_a_pdo_is_named_before_anything_is_written(connect, foreign):
    with pytest.raises(PdoSetupFailed) as refused:
        connect(profile(PROFILE.replace("pdo: 4", "pdo: 1")))
    assert refused.value.refusals[0] == (
        "node 1, 1800h: expected a PDO to set up, found no such object"
    )
    assert len(refused.value.refusals) == JOINTS
    assert not any(node.written for node in foreign.nodes)


def test_nothing_is_written_into_another_arm(connect, foreign):
    foreign.nodes[3].set_data(0x60C2, 1, b"\x04")
    with pytest.raises(WrongArm, match="joint 4 has a control period"):
        connect(profile())
    with pytest.raises(NodeMissing, match="node 9"):
        connect(profile(PROFILE + "joints: [{joint: 2, node: 9}]\n"))
    assert not any(node.written for node in foreign.nodes)


def test_equal_maps_are_no_writes_to_a_drive_that_refuses_them_all():
    """The fake refuses every write: equal maps are none, another is refused."""
    bus = FakeArmBus()
    arm = make(bus, profile=replace(sarcos(), configures_pdos=True))
    assert arm.connect().configured == ()
    arm.close()
    bus.objects[5, 0x1800, 2] = b"\xff"
    with pytest.raises(PdoSetupFailed, match="node 5 refused 1800h sub 1"):
        arm.connect()


def test_a_torque_that_was_left_in_a_drive_is_written_to_zero(connect, foreign):
    foreign.nodes[1].set_data(0x6071, 0, (-50 & 0xFFFF).to_bytes(2, "little"))
    arm = connect(profile())
    assert foreign.nodes[1].held(0x6071, 0) == 0
    arm.close()
    foreign.nodes[1].set_data(0x6071, 0, (-50 & 0xFFFF).to_bytes(2, "little"))
    assert "joint 2 (node 2): 6071h is 0; it was -50" in arm.connect().configured


def test_a_torque_that_a_drive_keeps_is_an_ending_of_its_own():
    """The fake refuses every write; its maps are equal already."""
    bus = FakeArmBus()
    bus.objects[3, 0x6071, 0] = (-50 & 0xFFFF).to_bytes(2, "little")
    with pytest.raises(ZeroingFailed) as refused:
        make(bus, profile=replace(sarcos(), configures_pdos=True)).connect()
    (told,) = refused.value.refusals
    assert told.startswith("joint 3 (node 3): node 3 refused 6071h sub 0: ")
    said = str(refused.value)
    assert "maker's tool" in said
    for wrong in ("maps may be fixed", "pdo_maps: compared"):
        assert wrong not in said


@pytest.mark.parametrize("last", [0x1803, 0x6071])
def test_what_was_written_is_undone_whatever_ends_the_connection_and_zeroes_are_named(
    settings, foreign, last
):
    """STOP is pressed as the last drive's last PDO becomes valid, or as its torque is set to 0."""
    drive = foreign.nodes[3]
    drive.set_data(0x6071, 0, (-50 & 0xFFFF).to_bytes(2, "little"))
    arm, write = unconnected(settings, profile()), drive.set_data

    def press(index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
        write(index, subindex, data, check_writable)
        if check_writable and index == last and not int.from_bytes(data, "little") & NOT_VALID:
            arm.stop()

    drive.set_data = press
    with pytest.raises(Stopped) as stopped:
        arm.connect()
    assert drive.written
    wait_for(lambda: own_maps(foreign))
    zeroed = "Written before, and not undone: joint 4 (node 4): 6071h is 0; it was -50."
    assert (zeroed in str(stopped.value)) is (last == 0x6071)


@pytest.mark.parametrize(
    ("index", "value", "refusal", "words"),
    [
        (0x1005, b"\x81\0\0\0", MappingMismatch, "node 6, 1005h"),
        (0x1014, b"\x99\0\0\0", MappingMismatch, "node 6, 1014h"),
        (0x1016, b"\0", MappingMismatch, "node 6, 1016h"),
        (0x1017, b"\x88\x13", MappingMismatch, "node 6, 1017h"),
        (0x6076, ABSENT, WrongArm, "6076h"),
    ],
)
def test_nothing_is_written_into_drives_that_are_refused_for_what_is_read(
    index, value, refusal, words
):
    bus = FakeArmBus()
    bus.objects[5, 0x1800, 2] = b"\xff"
    bus.objects[6, index, 0] = value
    with pytest.raises(refusal, match=words):
        make(bus, profile=replace(sarcos(), configures_pdos=True)).connect()
    assert not [data for i, data in bus.sent if 0x600 < i < 0x680 and data[0] >> 5 == 1]
