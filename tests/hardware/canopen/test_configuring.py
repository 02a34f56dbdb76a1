"""PDO set-up: drives with another mapping are configured if the bus profile requests it, otherwise refused."""

import struct
from dataclasses import replace

import pytest

from hardware import errors
from hardware.arm import DriveState, JointMode
from hardware.canopen.bus_profile import BusProfile
from operator_app.config.profile_file import parse_profile
from tests.hardware.conftest import JOINTS, PER_RAD, unconnected
from tests.hardware.control.canopen_arm.conftest import make, wait_for
from tests.hardware.fake_arm import FakeArmBus
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
MINUS_50 = struct.pack("<h", -50)


def maps_are_restored(foreign: ForeignArm) -> bool:
    """Whether all drives have their original PDOs."""
    cob_ids = [(node.value_of(0x1401, 1), node.value_of(0x1803, 1)) for node in foreign.nodes]
    return cob_ids == [(0x300 + node, 0x480 + node) for node in (1, 2, 3, 4)]


def profile(text: str = PROFILE) -> BusProfile:
    return parse_profile(text.encode(), "acme.yaml", joints=JOINTS)


def test_other_map_is_refused_or_written_as_the_profile_states(foreign, connect):
    with pytest.raises(errors.MappingMismatch, match="node 1, 1601h") as refused:
        connect(profile(PROFILE.replace("configured", "compared")))
    assert len(refused.value.differences) == JOINTS * 6
    assert not any(node.written for node in foreign.nodes)

    arm = connect(profile())
    first = foreign.nodes[0]
    # Disabled, emptied, filled, counted, then enabled.
    assert [write for write in first.written if write[0] in (0x1401, 0x1601)] == [
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


def test_written_maps_are_reported_and_lost_by_a_reset(foreign, connect):
    arm = connect(profile())
    arm.close()
    written = [len(node.written) for node in foreign.nodes]
    reconnected = arm.connect()  # resets communication, and with it the maps
    assert [len(node.written) for node in foreign.nodes] == [2 * n for n in written]
    assert len(reconnected.configured) == JOINTS * 3
    assert reconnected.configured[0] == (
        "joint 1 (node 1): RPDO2 is 6040h(16) + 607Ah(32) + 6060h(16) on 201h; it was "
        "607Ah(32) + 6040h(16) on 301h, type 255"
    )
    assert not any(index in (0x1010, 0x1011) for n in foreign.nodes for index, _, _ in n.written)


def test_equal_map_is_not_written(foreign, connect):
    equal_maps = PROFILE[: PROFILE.index("commands:")] + (
        "commands:\n"
        "  - {pdo: 2, cob_id: 300h + node, map: [607Ah(32), 6040h(16)]}\n"
        "  - {pdo: 3, cob_id: 400h + node, map: [6060h(16), 6071h(16)]}\n"
        "answers:\n"
        "  - {pdo: 3, cob_id: 380h + node, map: [6077h(32), 6064h(32)]}\n"
        "  - {pdo: 4, cob_id: 480h + node, map: [6061h(16), 6041h(16)]}\n"
    )
    foreign.nodes[2].set_data(0x1803, 2, b"\xff")
    connect(profile(equal_maps))
    assert [node.written for node in foreign.nodes] == [
        [],
        [],
        [(0x1803, 1, NOT_VALID | 0x483), (0x1803, 2, 1), (0x1803, 1, 0x483)],
        [],
    ]


def test_conflicting_pdo_is_disabled_first(foreign, connect):
    connect(profile(PROFILE.replace("200h + node", "400h + node")))
    node = foreign.nodes[1]
    assert node.value_of(0x1402, 1) == NOT_VALID | 0x402
    assert node.value_of(0x1401, 1) == 0x402
    assert node.written[0] == (0x1402, 1, NOT_VALID | 0x402)


def test_fixed_map_is_reported_and_other_maps_are_restored(foreign, connect):
    foreign.nodes[2].fixed.add(0x1A02)
    with pytest.raises(errors.PdoSetupFailed) as refused:
        connect(profile())
    (refusal,) = refused.value.refusals
    assert refusal.startswith("joint 3 (node 3): node 3 refused 1A02h sub 0: ")
    assert "(06010002h); required map: 6041h(16) + 6064h(32)" in refusal
    for phrase in ("pdo_maps: compared", "maker's tool", "Nothing was enabled"):
        assert phrase in str(refused.value)
    wait_for(lambda: maps_are_restored(foreign))
    assert all(axis.word == 0 for axis in foreign.axes)


def test_drive_that_confirms_a_map_and_ignores_it_is_reported(foreign, connect):
    drive = foreign.nodes[2]
    write = drive.set_data

    def confirm(index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
        if not check_writable or index != 0x1A02:
            write(index, subindex, data, check_writable)

    drive.set_data = confirm
    with pytest.raises(errors.PdoSetupFailed) as refused:
        connect(profile())
    (refusal,) = refused.value.refusals
    assert refusal.startswith("node 3, 1A02h: expected TPDO3 = ")
    assert refusal.endswith(" although it was written")
    wait_for(lambda: maps_are_restored(foreign))


def test_missing_pdo_is_reported_before_anything_is_written(foreign, connect):
    with pytest.raises(errors.PdoSetupFailed) as refused:
        connect(profile(PROFILE.replace("pdo: 4", "pdo: 1")))
    assert refused.value.refusals[0] == (
        "node 1, 1800h: expected a PDO to set up, found no such object"
    )
    assert len(refused.value.refusals) == JOINTS
    assert not any(node.written for node in foreign.nodes)


def test_nothing_is_written_to_another_arm(foreign, connect):
    foreign.nodes[3].set_data(0x60C2, 1, b"\x04")
    with pytest.raises(errors.WrongArm, match="joint 4 has a control period"):
        connect(profile())
    with pytest.raises(errors.NodeMissing, match="node 9"):
        connect(profile(PROFILE + "joints: [{joint: 2, node: 9}]\n"))
    assert not any(node.written for node in foreign.nodes)


def test_nonzero_target_torque_is_set_to_zero(foreign, connect):
    foreign.nodes[1].set_data(0x6071, 0, MINUS_50)
    arm = connect(profile())
    assert foreign.nodes[1].value_of(0x6071, 0) == 0
    arm.close()
    foreign.nodes[1].set_data(0x6071, 0, MINUS_50)
    assert "joint 2 (node 2): 6071h is 0; it was -50" in arm.connect().configured


def test_target_torque_that_cannot_be_zeroed_is_an_error():
    """The fake drives refuse every write; their maps are equal."""
    bus = FakeArmBus()
    bus.objects[3, 0x6071, 0] = MINUS_50
    with pytest.raises(errors.ZeroingFailed) as refused:
        make(bus, profile=replace(sarcos(), configures_pdos=True)).connect()
    (refusal,) = refused.value.refusals
    assert refusal.startswith("joint 3 (node 3): node 3 refused 6071h sub 0: ")
    message = str(refused.value)
    assert "maker's tool" in message
    for wrong in ("maps may be fixed", "pdo_maps: compared"):
        assert wrong not in message


@pytest.mark.parametrize("last", [0x1803, 0x6071])
def test_stop_while_connecting_restores_maps_and_reports_zeroed_torque(settings, foreign, last):
    """STOP is pressed as the last PDO of the last drive is enabled, or as its torque is set to 0."""
    drive = foreign.nodes[3]
    drive.set_data(0x6071, 0, MINUS_50)
    arm, write = unconnected(settings, profile()), drive.set_data

    def write_and_stop(
        index: int, subindex: int, data: bytes, check_writable: bool = False
    ) -> None:
        write(index, subindex, data, check_writable)
        if check_writable and index == last and not int.from_bytes(data, "little") & NOT_VALID:
            arm.stop()

    drive.set_data = write_and_stop
    with pytest.raises(errors.Stopped) as stopped:
        arm.connect()
    assert drive.written
    wait_for(lambda: maps_are_restored(foreign))
    zeroed = "Written before, and not undone: joint 4 (node 4): 6071h is 0; it was -50."
    assert (zeroed in str(stopped.value)) is (last == 0x6071)


@pytest.mark.parametrize(
    ("index", "value", "error", "message"),
    [
        (0x1005, b"\x81\0\0\0", errors.MappingMismatch, "node 6, 1005h"),
        (0x1014, b"\x99\0\0\0", errors.MappingMismatch, "node 6, 1014h"),
        (0x1016, b"\0", errors.MappingMismatch, "node 6, 1016h"),
        (0x1017, b"\x88\x13", errors.MappingMismatch, "node 6, 1017h"),
        (0x6076, ABSENT, errors.WrongArm, "6076h"),
        (0x6076, bytes(4), errors.WrongArm, "6076h"),
        (0x6076, 0x0504_0000, errors.SdoRefused, "refused 6076h"),  # a time-out is no absence
    ],
)
def test_nothing_is_written_to_drives_with_invalid_objects(index, value, error, message):
    bus = FakeArmBus()
    bus.objects[5, 0x1800, 2] = b"\xff"
    bus.objects[6, index, 0] = value
    with pytest.raises(error, match=message):
        make(bus, profile=replace(sarcos(), configures_pdos=True)).connect()
    assert not [data for i, data in bus.sent if 0x600 < i < 0x680 and data[0] >> 5 == 1]
