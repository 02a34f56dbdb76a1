"""Bus profiles: all keys are read; each mistake gives one problem with its place."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.arm import JointMode
from hardware.canopen.bus_profile import BusProfile, JointProfile, Pdo
from operator_app.config.profile_file import format_profile, load_profile, parse_profile
from tests.oracles.mistakes import parse_problems, single_problem

GOOD = """\
schema: sarcal/profile/1
name: acme
supervisor: none
serial_number: ACME-7
pdo_maps: configured
commands:
  - {pdo: 2, cob_id: 300h + node, map: [607Ah(32), 6040h(16)]}
  - {pdo: 3, cob_id: 400h + node, map: [6060h(8), 6071h(16), 0005h(8)]}
answers:
  - {pdo: 3, cob_id: 380h + node, map: [6077h(16), 6064h(32), 6041h(16)]}
joints:
  - {joint: 1, node: 21}
  - {joint: 2, node: 22, direction: -1, counts_per_rev: 65536, zero_counts: -12, rated_torque_nm: 3.5}
  - joint: 3
    node: 33
    answers:
      - {pdo: 1, cob_id: 1A1h, map: [6041h(16), 2011h sub 3(16)]}
      - {pdo: 4, cob_id: 4A1h, map: [6064h(64)]}
      - {pdo: 5, cob_id: 2A1h, map: [6077h(32)]}
compared: [60C2h]
device_type: {value: 00040192h, mask: 0000FFFFh}
modes: {free: 4}
heartbeat: {slowest_ms: 2000, silent_after_s: 4}
sdo_timeout_s: 2.5
enabling_timeout_s: 2
"""


def parse(text, joints=3):
    return parse_profile(text.encode(), "p.yaml", joints=joints)


def test_all_keys_are_read():
    profile = parse(GOOD)
    assert profile.drives == profile.nodes == (21, 22, 33)
    assert (profile.supervisor, profile.serial_number) == (None, "ACME-7")
    one, two, three = profile.joints
    assert [pdo.cob_id for pdo in one.commands] == [0x315, 0x415]
    assert one.answers[0].entries == ((0x6077, 0, 16), (0x6064, 0, 32), (0x6041, 0, 16))
    assert (two.direction, two.counts_per_rev, two.zero_counts) == (-1, 65536, -12)
    assert two.rated_torque_nm == 3.5
    assert {pdo.number: pdo.cob_id for pdo in three.answers} == {1: 0x1A1, 4: 0x4A1, 5: 0x2A1}
    assert three.answers[0].entries[1] == (0x2011, 3, 16)
    assert profile.is_drive(0x12340192)
    assert not profile.is_drive(0x00020191)
    assert profile.mode_codes == {JointMode.POSITION: 8, JointMode.FREE: 4}
    assert (profile.slowest_heartbeat_ms, profile.heartbeat_timeout_s) == (2000, 4.0)
    assert (profile.sdo_timeout_s, profile.enabling_timeout_s) == (2.5, 2.0)
    assert profile.compared == {0x60C2}
    assert profile.configures_pdos
    for line in ("", "pdo_maps: compared\n"):
        assert not parse(GOOD.replace("pdo_maps: configured\n", line)).configures_pdos


def test_packaged_profile_fits_any_number_of_joints():
    for joints in (1, 7, 15):
        profile = load_profile("sarcos", joints=joints)
        assert profile.drives == tuple(range(1, joints + 1))
    assert len(load_profile("sarcos").joints) == 15


MISTAKES = [
    ("serial_number: ACME-7\n", "", "serial_number: is missing"),
    ("6064h(32)", "6064h(24)", "6064h(24) cannot be read or written"),
    ("6064h(32)", "6064h(320)", "'6064h(320)' is not a valid mapped object"),
    ("6064h(32)", "6064(32)", "'6064(32)' is not a valid mapped object"),
    ("[6077h(16), 6064h(32), 6041h(16)]", "[6077h(16), 6064h(32)]", "nothing carries 6041h"),
    ("607Ah(32), 6040h(16)", "607Ah(16), 6040h(16)", "16 bits of target (607Ah)"),
    ("6071h(16), 0005h(8)", "60FEh(32)", "60FEh(32) is not an object that this program commands"),
    ("6071h(16), 0005h(8)", "6071h(4)", "6071h(4) is not a whole number of bytes"),
    ("6071h(16), 0005h(8)", "6071h(64)", "is longer than the 8 bytes of a frame"),
    ("6071h(16), 0005h(8)", "607Ah(32)", "607Ah is carried 2 times"),
    ("pdo: 3, cob_id: 400h", "pdo: 2, cob_id: 400h", "PDO 2 is listed twice"),
    ("300h + node", "380h + node", "395h, for joint 1, is taken by joint 1"),
    ("300h + node", "600h + node", "615h, for joint 1, is taken by SDO"),
    ("300h + node", "300h+node", "'300h+node' is not a valid identifier"),
    ("node: 22", "node: 21", "node 21 is joint 1 and joint 2"),
    ("node: 22", "node: 127", "joints[joint 2].node: must be at most 126"),
    ("joint: 2", "joint: 1", "joint 1 is listed twice"),
    ("joint: 3", "joint: 9", "there is no joint 9; the arm's joints are 1 to 3"),
    ("direction: -1", "direction: 2", "direction: 2 is not a valid value; use one of: -1, 1"),
    ("compared: [60C2h]", "compared: [6041h]", "compared[1]: 6041h cannot be compared"),
    ("free: 4", "free: 8", "modes.free: is the code of position mode as well"),
    ("pdo_maps: configured", "pdo_maps: stored", "'stored' is not a valid value; use one of: compared"),
    ("value: 00040192h", "value: 0x40192", "'0x40192' is not a valid hexadecimal number"),
    ("slowest_ms", "slowest_s", "heartbeat.slowest_s: unknown key; did you mean slowest_ms?"),
    ("answers:\n  - {pdo: 3, cob_id: 380h + node, map: [6077h(16), 6064h(32), 6041h(16)]}\n", "",
     "answers: joint 1 has none"),
    ("sarcal/profile/1", "sarcal/profile/2", "the profile file has version 2"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), MISTAKES)
def test_one_mistake_gives_one_problem_with_its_place(old, new, message):
    assert message in str(single_problem(parse, GOOD, old, new))


def test_rescaled_drive_conflicts_with_supervisor():
    text = GOOD.replace("supervisor: none", "supervisor: 40")
    serial_problem, joint_problem = parse_problems(parse, text)
    assert "serial_number: is stated by the supervisor" in str(serial_problem)
    assert "joints[joint 2]: a supervisor sets home offsets (607Ch)" in str(joint_problem)


@given(
    nodes=st.lists(st.integers(1, 126), min_size=1, max_size=15, unique=True),
    first_identifier=st.integers(1, 100),
    own_identifiers=st.booleans(),
)
@settings(deadline=None, max_examples=40)
def test_written_profile_is_read_back(nodes, first_identifier, *, own_identifiers):
    def joint(k, node):
        base = 0x100 + first_identifier + k if own_identifiers else 0x180 + node

        def pdo(number, *entries):
            return Pdo(number=number, cob_id=base + 0x100 * number, entries=entries)

        return JointProfile(
            node=node,
            commands=(pdo(1, (0x6040, 0, 16), (0x607A, 0, 32), (0x6060, 0, 8)),),
            answers=(
                pdo(2, (0x6041, 0, 16), (0x2000, 7, 16)),
                pdo(3, (0x6064, 0, 32), (0x6077, 0, 16)),
            ),
        )

    profile = BusProfile(
        name="made",
        joints=tuple(joint(k, node) for k, node in enumerate(nodes)),
        supervisor=None,
        serial_number="0-1: 2",
        configures_pdos=own_identifiers,
        compared=frozenset({0x607D, 0x60C2}),
    )
    assert parse_profile(format_profile(profile, comment="x\ny"), "x", joints=len(nodes)) == profile
