"""`sarcal probe --json`: keys that programs rely on."""

from hardware.canopen.drive_settings import DrivePdo
from hardware.commissioning.probe import FoundNode, Probe
from operator_app.commands.probe import CHECK, probe_json


def test_json_lists_valid_pdos_and_counts_all():
    entries = ((0x6064, 0, 32),)
    first, second = (
        {"sent": sent, "number": number, "cob_id": 0x181, "transmission": 1, "entries": entries}
        for sent, number in ((False, 2), (True, 1))
    )
    invalid = DrivePdo(**first | {"number": 1}, valid=False)
    pdos = (invalid, DrivePdo(**first, valid=True), DrivePdo(**second, valid=True))
    node = FoundNode(
        node=1, device_type=0x20192, drive=True, heard=True, pdos=pdos, widths={0x6064: 32}
    )
    (node_json,) = probe_json(Probe(busy="", heard=(1,), nodes=(node,)))["nodes"]
    assert node_json["pdos"] == [first, second]
    assert node_json["room"] == {"taken": [1, 2], "sent": [1], "bits": [(0x6064, 32)]}
    assert set(node_json) == {
        "node", "device_type", "device_name", "serial_number", "drive", "position_counts", "heard", "problems",
        "pdos", "described", "supervises", "room", "notes", "unread",
    }  # fmt: skip


def test_counting_direction_is_checked_with_a_command_that_shows_counts(approve):
    """`sarcal monitor` prints none, and no drive sends any without SYNC."""
    assert "monitor" not in CHECK
    approve(CHECK)
