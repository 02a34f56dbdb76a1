"""The EDS files against the constants of `hardware.canopen.objects`, dcfchk, and the dictionaries of the nodes."""

import configparser
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import canopen
import pytest

from hardware.canopen import objects
from hardware.eds import EDS_FILES, variables
from hardware.virtual.drive_node import RPDO1, TPDO1
from tests.oracles.profiles import sarcos

NODE = 3
NOT_REGISTERED, REVISION = 0, 0x00010000
PROFILE = sarcos().joints[NODE - 1]
BY_FILE = pytest.mark.parametrize(
    ("product", "file"), EDS_FILES.items(), ids=[path.name for path in EDS_FILES.values()]
)
DEFAULTS = {
    objects.JOINT_PRODUCT: {
        (objects.RPDO1_COMMUNICATION, 2): 254,
        (objects.MAX_TORQUE, 0): 1000,
        (objects.SENSOR, objects.SENSOR_KIND): objects.SensorKind.NONE,
    },
    objects.SUPERVISOR_PRODUCT: {
        (objects.DEVICE_NAME, 0): "sarcal virtual supervisor",
        (objects.SLOTS, objects.SLOTS_ACTIVE): objects.Slot.NONE,
        (objects.SLOTS, objects.SLOTS_A): objects.SlotState.EMPTY,
        (objects.SLOTS, objects.SLOTS_B): objects.SlotState.EMPTY,
    },
}
"""Those that neither dcfchk nor an operator compares when it connects to the virtual arm."""


def read_eds(path: Path) -> configparser.RawConfigParser:
    """Read a file; repeated sections and keys are errors."""
    parser = configparser.RawConfigParser(strict=True)
    parser.read_string(path.read_text("ascii"))
    return parser


@BY_FILE
def test_dcfchk_reports_no_errors(product, file):
    dcfchk = shutil.which("dcfchk", path=f"{sysconfig.get_path('scripts')}{os.pathsep}{os.defpath}")
    if dcfchk is None:
        pytest.skip("dcfchk is not installed (pip install dcf-tools)")
    result = subprocess.run(
        [sys.executable, "-W", "error", dcfchk, "-n", str(NODE), str(file)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")


@BY_FILE
def test_entries_are_what_canopen_reads_from_the_file(product, file):
    imported = canopen.import_od(str(file), NODE)
    ours = variables(product, NODE)
    assert {index for index, _ in ours} == imported.indices.keys()
    for key, variable in ours.items():
        for name in ("name", "data_type", "access_type", "default", "pdo_mappable", "min", "max"):
            expected = getattr(imported.get_variable(*key), name)
            assert getattr(variable, name) == expected, (key, name)


def test_index_constants_are_the_indices_of_the_files():
    indices = {
        value
        for name, value in vars(objects).items()
        if name.isupper() and isinstance(value, int) and 0x1000 <= value < 0x10000
    }
    # Of other makers' drives.
    indices -= {objects.POSITION_OFFSET, objects.TORQUE_OFFSET, objects.ABORT_OPTION}
    # The program has no use for the versions of a device.
    assert indices | {0x1009, 0x100A} == {
        index for product in EDS_FILES for index, _ in variables(product, NODE)
    }


@BY_FILE
def test_default_values_are_those_of_the_constants(product, file):
    entries = variables(product, NODE)
    expected = DEFAULTS[product] | {
        (objects.IDENTITY, objects.IDENTITY_PRODUCT): product,
        (objects.HEARTBEAT_PRODUCER, 0): round(objects.HEARTBEAT_PERIOD_S * 1e3),
        (objects.HEARTBEAT_CONSUMER, 1): objects.OPERATOR_NODE << 16
        | round(objects.HEARTBEAT_TIMEOUT_S * 1e3),
    }
    assert {key: entries[key].default for key in expected} == expected
    history = [sub for index, sub in entries if index == objects.ERROR_FIELD and sub > 0]
    assert history == list(range(1, objects.ERROR_HISTORY + 1))
    info = read_eds(file)["DeviceInfo"]
    assert int(info["VendorNumber"], 0) == NOT_REGISTERED
    assert int(info["ProductNumber"], 0) == product
    assert int(info["RevisionNumber"], 0) == REVISION
    assert info["ProductName"] == entries[objects.DEVICE_NAME, 0].default


def test_ranges_are_those_of_the_constants():
    joint = variables(objects.JOINT_PRODUCT, NODE)
    digits, power = (joint[objects.CONTROL_PERIOD, sub].default for sub in (1, 2))
    assert digits * 10.0**power == pytest.approx(objects.CONTROL_PERIOD_S, rel=1e-15)
    assert (joint[objects.TARGET_TORQUE, 0].min, joint[objects.TARGET_TORQUE, 0].max) == (0, 0)
    supervisor = variables(objects.SUPERVISOR_PRODUCT, objects.SUPERVISOR_NODE)
    command = supervisor[objects.COMMAND, 0]
    assert [*range(command.min, command.max + 1)] == [*objects.ParameterCommand]
    token = supervisor[objects.TOKEN, 0]
    assert (token.min, token.max) == (0, objects.OPERATOR_NODE)


@BY_FILE
def test_object_lists_contain_every_section_once(product, file):
    eds = read_eds(file)
    manufacturer = range(0x2000, 0x6000)
    mandatory = {0x1000, 0x1001, 0x1018}
    present = {int(name, 16) for name in eds.sections() if len(name) == 4}
    lists = {
        "MandatoryObjects": present & mandatory,
        "OptionalObjects": {i for i in present - mandatory if i not in manufacturer},
        "ManufacturerObjects": {i for i in present if i in manufacturer},
    }
    for name, indices in lists.items():
        listed = [
            int(eds[name][str(k)], 0) for k in range(1, int(eds[name]["SupportedObjects"]) + 1)
        ]
        assert listed == sorted(indices)
    assert eds["FileInfo"]["FileName"] == file.name


@pytest.mark.parametrize(
    ("pdo", "communication", "index", "layout"),
    [
        (PROFILE.answers[0], objects.TPDO1_COMMUNICATION, objects.TPDO1_MAP, TPDO1),
        (PROFILE.commands[0], objects.RPDO1_COMMUNICATION, objects.RPDO1_MAP, RPDO1),
    ],
)
def test_packaged_profile_has_the_pdos_of_the_virtual_drive(pdo, communication, index, layout):
    """Operator and device state them separately."""
    entries = variables(objects.JOINT_PRODUCT, NODE)
    assert entries[communication, 1].default & 0x7FF == pdo.cob_id
    mapped = [entries[index, k + 1].default for k in range(entries[index, 0].default)]
    assert mapped == [number << 16 | sub << 8 | bits for number, sub, bits in pdo.entries]
    for (number, sub, bits), letter in zip(pdo.entries, layout.format[1:], strict=True):
        entry = entries[number, sub]
        assert entry.STRUCT_TYPES[entry.data_type].format[-1] == letter
        assert len(entry) == bits
        assert entry.pdo_mappable
