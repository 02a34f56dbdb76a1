"""An arm with another set-up is refused, then moved with the profile drafted from a probe."""

import math
from dataclasses import replace

import pytest

from hardware.arm import DriveState, JointMode
from hardware.commissioning.profile_draft import DraftRefused
from hardware.errors import CommandRefused, MappingMismatch, UploadRefused, WrongArm
from tests.hardware.conftest import JOINTS, PER_RAD, drafted, running_foreign_arm
from tests.oracles.profiles import sarcos

POSITION, FREE = JointMode.POSITION, JointMode.FREE
NODES = range(1, JOINTS + 1)


@pytest.fixture
def elsewhere(settings):
    yield from running_foreign_arm(settings, 11, 12, 23, 34)


def test_foreign_arm_with_wrong_profile_is_refused(foreign, connect):
    with pytest.raises(MappingMismatch) as refused:
        connect(sarcos(JOINTS))
    tpdo1 = "6041h(16) + 6064h(32) + 6077h(16)"
    for difference in (
        *(f"node {n}, 1A00h: expected TPDO1 = {tpdo1}, found no such object" for n in NODES),
        *(f"node {n}, 1400h sub 1: expected 20{n}h, found no such object" for n in NODES),
        "node 16: no answer",
    ):
        assert difference in refused.value.differences
    assert "sarcal probe --draft" in str(refused.value)
    assert all(axis.word == 0 for axis in foreign.axes)


def test_foreign_arm_is_described_by_a_draft_and_moves_with_it(settings, elsewhere, connect):
    profile = drafted(settings)
    assert profile.drives == (11, 12, 23, 34)
    assert profile.supervisor is None
    assert profile.serial_number == "50011-50012-50023-50034"
    third = profile.joints[2]
    assert [(p.number, p.cob_id) for p in third.commands] == [(2, 0x317), (3, 0x417)]
    assert [(p.number, p.cob_id) for p in third.answers] == [(3, 0x397), (4, 0x497)]
    assert third.answers[0].entries == ((0x6077, 0, 32), (0x6064, 0, 32))
    assert profile.compared == {0x60C2}
    assert all(axis.word == 0 for axis in elsewhere.axes), "a probe commands nothing"
    arm = connect(profile)
    assert arm.snapshot().positions_rad == pytest.approx(
        [1000 * (k + 1) / PER_RAD for k in range(JOINTS)]
    )
    arm.take_control()
    assert {j.drive for j in arm.snapshot().joints} == {DriveState.OPERATION_ENABLED}
    arm.set_modes([FREE, POSITION, FREE, POSITION])
    assert [axis.mode for axis in elsewhere.axes] == [10, 8, 10, 8]
    assert arm.move({2: 0.5, 4: -0.25}, speed_rad_per_s=0.9).reached
    assert arm.capture(10).mean_rad == pytest.approx(
        [1000 / PER_RAD, 0.5, 3000 / PER_RAD, -0.25], abs=1 / PER_RAD
    )
    arm.set_modes([POSITION] * JOINTS)  # these drives set bit 12 in free mode as well
    assert [axis.mode for axis in elsewhere.axes] == [8] * JOINTS
    assert arm.active_parameters() == b""
    with pytest.raises(UploadRefused, match="no supervisor"):
        arm.upload_parameters(b"any")
    arm.stop()
    assert arm.snapshot().stopped
    assert arm.close()
    assert {axis.status for axis in elsewhere.axes} == {0x07}


def test_profile_direction_zero_and_resolution_apply(settings, foreign, connect):
    profile = drafted(settings)
    first, second, *others = profile.joints
    second = replace(second, direction=-1, zero_counts=2500, counts_per_rev=72_000.0)
    arm = connect(replace(profile, joints=(first, second, *others)))
    per_rad = 72_000 / math.tau
    assert arm.snapshot().positions_rad[1] == pytest.approx((2500 - 2000) / per_rad)
    arm.take_control()
    assert arm.move({2: 0.3}, speed_rad_per_s=0.9).reached
    assert foreign.axes[1].counts == pytest.approx(2500 - 0.3 * per_rad, abs=1)
    reading = arm.capture(5)
    assert reading.mean_rad[1] == pytest.approx(0.3, abs=1 / per_rad)
    assert reading.sd_rad[1] == 0.0
    with pytest.raises(CommandRefused, match="outside"):
        arm.move({2: 1.6}, speed_rad_per_s=0.9)


def test_missing_compared_object_raises_wrong_arm(settings, foreign, connect):
    profile = replace(drafted(settings), compared=frozenset({0x60C2, 0x2100}))
    with pytest.raises(WrongArm, match="joint 1 has no object 2100h"):
        connect(profile)


def test_draft_refusal_gives_reason_per_drive(settings, foreign):
    foreign.nodes[2].set_data(0x1803, 2, b"\xff")
    foreign.nodes[3].set_data(0x1601, 0, b"\x01")
    with pytest.raises(DraftRefused) as refused:
        drafted(settings)
    assert refused.value.reasons == (
        "node 3: no usable TPDO carries 6041h (TPDO4 is of transmission type 255, not 1 (on every SYNC))",
        "node 4: no usable RPDO carries 6040h",
    )


def test_configure_drafts_pdo_maps_for_unusable_drives(settings, foreign, connect):
    for node in foreign.nodes:
        node.set_data(0x1803, 2, b"\xff")
        node.set_data(0x1402, 1, (0x80000402).to_bytes(4, "little"))
    with pytest.raises(DraftRefused, match="no usable TPDO carries 6041h"):
        drafted(settings)
    profile = drafted(settings, configure=True)
    assert not any(node.written for node in foreign.nodes), "a probe writes nothing"
    second = profile.joints[1]
    # Widths are those of these drives' objects; entries beyond 8 bytes go into the next PDO.
    assert [(p.number, p.cob_id, p.entries) for p in (*second.commands, *second.answers)] == [
        (2, 0x202, ((0x6040, 0, 16), (0x607A, 0, 32), (0x6060, 0, 16))),
        (3, 0x182, ((0x6041, 0, 16), (0x6064, 0, 32))),
        (4, 0x282, ((0x6077, 0, 32),)),
    ]
    arm = connect(profile)
    arm.take_control()
    assert arm.move({2: 0.5}, speed_rad_per_s=0.9).reached
    assert arm.capture(5).mean_rad[1] == pytest.approx(0.5, abs=1 / PER_RAD)


@pytest.mark.parametrize("index", [0x6040, 0x6041, 0x6077])
def test_draft_refuses_drive_lacking_pdo_or_object(settings, foreign, index):
    del foreign.nodes[1].object_dictionary[0x1803]
    del foreign.nodes[2].object_dictionary[index]
    with pytest.raises(DraftRefused) as refused:
        drafted(settings, configure=True)
    assert refused.value.reasons == (
        "node 2: 2 TPDOs are needed, but it has 1",
        f"node 3: {index:04X}h cannot be read",
    )


@pytest.mark.campaign
def test_draft_refuses_drive_that_stopped_answering(settings, foreign):
    """The profile that is compared with has this node number too; the difference from it is not the reason."""
    server = foreign.nodes[1].sdo

    def answer_up_to_1018h(cob_id: int, data: bytearray, stamp: float) -> None:
        if data[1:3] in (b"\x00\x10", b"\x08\x10", b"\x18\x10"):
            server.on_request(cob_id, data, stamp)

    foreign.network.unsubscribe(0x602)
    foreign.network.subscribe(0x602, answer_up_to_1018h)
    with pytest.raises(DraftRefused, match=r"^Node 2 does not answer when asked for") as refused:
        drafted(settings, configure=True)
    assert len(refused.value.reasons) == 1
