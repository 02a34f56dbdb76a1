"""The EDS files against the numbers in `hardware.canopen.objects`, against dcfchk, and as nodes get them."""

import configparser
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import canopen
import pytest
from canopen.objectdictionary import ODVariable, datatypes

from hardware.canopen import objects
from hardware.eds import EDS_FILES, node_dictionary, product_dictionary, variables
from hardware.virtual.drive_node import RPDO1, TPDO1
from tests.oracles.profiles import sarcos

NODE = 3
OWN = sarcos().joints[NODE - 1]
BY_FILE = pytest.mark.parametrize(
    ("product", "file"), EDS_FILES.items(), ids=[path.name for path in EDS_FILES.values()]
)
DEFAULTS = {
    objects.JOINT_PRODUCT: {
        (objects.DEVICE_TYPE, 0): objects.DRIVE_DEVICE_TYPE,
        (objects.DEVICE_NAME, 0): objects.JOINT_DEVICE_NAME,
        (objects.RPDO1_COMMUNICATION, 1): objects.COB_RPDO1 + NODE,
        (objects.RPDO1_COMMUNICATION, 2): objects.RPDO_ON_RECEIPT,
        (objects.TPDO1_COMMUNICATION, 1): objects.COB_TPDO1 + NODE,
        (objects.TPDO1_COMMUNICATION, 2): objects.TPDO_EVERY_SYNC,
        (objects.QUICK_STOP_OPTION, 0): 6,
        (objects.MAX_TORQUE, 0): 1000,
        (objects.SUPPORTED_MODES, 0): sum(1 << code - 1 for code in objects.JOINT_MODE),
        (objects.SENSOR, objects.SENSOR_KIND): objects.SensorKind.NONE,
    },
    objects.SUPERVISOR_PRODUCT: {
        (objects.DEVICE_TYPE, 0): objects.SUPERVISOR_DEVICE_TYPE,
        (objects.DEVICE_NAME, 0): objects.SUPERVISOR_DEVICE_NAME,
        (objects.SLOTS, objects.SLOTS_ACTIVE): objects.Slot.NONE,
        (objects.SLOTS, objects.SLOTS_A): objects.SlotState.EMPTY,
        (objects.SLOTS, objects.SLOTS_B): objects.SlotState.EMPTY,
    },
}


def _file(path: Path) -> configparser.RawConfigParser:
    """Refuses sections and keys that are given twice."""
    read = configparser.RawConfigParser(strict=True)
    read.read_string(path.read_text("ascii"))
    return read


@BY_FILE
def test_dcfchk_finds_nothing(product, file):
    here = shutil.which("dcfchk", path=f"{sysconfig.get_path('scripts')}{os.pathsep}{os.defpath}")
    if here is None:
        pytest.skip("dcfchk is not installed (pip install dcf-tools)")
    done = subprocess.run(
        [sys.executable, "-W", "error", here, "-n", str(NODE), str(file)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@BY_FILE
def test_a_node_gets_what_canopen_reads_from_the_file(product, file):
    imported = variables(canopen.import_od(str(file), NODE))
    ours = variables(product_dictionary(product, NODE))
    assert ours.keys() == imported.keys()
    for key, variable in imported.items():
        for name in ("name", "data_type", "access_type", "default", "pdo_mappable", "min", "max"):
            assert getattr(ours[key], name) == getattr(variable, name), (key, name)


def test_every_index_the_code_names_is_in_a_file_and_the_other_way_round():
    """An index constant that is in no EDS would be an object that no node has."""
    indices = {
        value
        for name, value in vars(objects).items()
        if name.isupper() and isinstance(value, int) and 0x1000 <= value < 0x10000
    }
    # Numbers of that size that are no indices.
    indices -= {objects.REVISION}
    # What other makers' drives may have, and ours do not.
    indices -= {objects.POSITION_OFFSET, objects.TORQUE_OFFSET}
    assert indices == {
        index for product in EDS_FILES for index in product_dictionary(product, NODE).indices
    }


@BY_FILE
def test_values_that_code_relies_on_are_those_of_the_file(product, file):
    entries = variables(product_dictionary(product, NODE))
    identity = {
        objects.IDENTITY_VENDOR: objects.VENDOR_ID,
        objects.IDENTITY_PRODUCT: product,
        objects.IDENTITY_REVISION: objects.REVISION,
    }
    wanted = DEFAULTS[product] | {(objects.IDENTITY, sub): v for sub, v in identity.items()}
    wanted |= {
        (objects.SYNC_COB_ID, 0): objects.COB_SYNC,
        (objects.EMCY_COB_ID, 0): objects.COB_EMCY + NODE,
        (objects.SDO_SERVER, 1): objects.COB_SDO_TO_SERVER + NODE,
        (objects.SDO_SERVER, 2): objects.COB_SDO_FROM_SERVER + NODE,
        (objects.HEARTBEAT_PRODUCER, 0): round(objects.HEARTBEAT_PERIOD_S * 1e3),
        (objects.HEARTBEAT_CONSUMER, 1): objects.OPERATOR_NODE << 16
        | round(objects.HEARTBEAT_TIMEOUT_S * 1e3),
    }
    assert {key: entries[key].default for key in wanted} == wanted
    history = [sub for index, sub in entries if index == objects.ERROR_FIELD and sub > 0]
    assert history == list(range(1, objects.ERROR_HISTORY + 1))
    info = _file(file)["DeviceInfo"]
    assert int(info["VendorNumber"], 0) == objects.VENDOR_ID
    assert int(info["ProductNumber"], 0) == product
    assert int(info["RevisionNumber"], 0) == objects.REVISION
    assert info["ProductName"] == entries[objects.DEVICE_NAME, 0].default


def test_ranges_are_those_of_the_codes():
    joint = variables(node_dictionary(NODE))
    period = (
        joint[objects.CONTROL_PERIOD, 1].default * 10.0 ** joint[objects.CONTROL_PERIOD, 2].default
    )
    assert period == pytest.approx(objects.CONTROL_PERIOD_S, rel=1e-15)
    assert (joint[objects.TARGET_TORQUE, 0].min, joint[objects.TARGET_TORQUE, 0].max) == (0, 0)
    supervisor = variables(node_dictionary(objects.SUPERVISOR_NODE))
    command = supervisor[objects.COMMAND, 0]
    assert [*range(command.min, command.max + 1)] == [*objects.ParameterCommand]
    token = supervisor[objects.TOKEN, 0]
    assert (token.min, token.max) == (0, objects.OPERATOR_NODE)


@BY_FILE
def test_every_section_is_listed_once_where_it_belongs(product, file):
    read = _file(file)
    makers = range(0x2000, 0x6000)
    mandatory = {0x1000, 0x1001, 0x1018}
    present = {int(name, 16) for name in read.sections() if len(name) == 4}
    lists = {
        "MandatoryObjects": present & mandatory,
        "OptionalObjects": {i for i in present - mandatory if i not in makers},
        "ManufacturerObjects": {i for i in present if i in makers},
    }
    for name, indices in lists.items():
        listed = [
            int(read[name][str(k)], 0) for k in range(1, int(read[name]["SupportedObjects"]) + 1)
        ]
        assert listed == sorted(indices)
    assert read["FileInfo"]["FileName"] == file.name


@pytest.mark.parametrize(
    ("pdo", "communication", "index", "layout"),
    [
        (OWN.answers[0], objects.TPDO1_COMMUNICATION, objects.TPDO1_MAP, TPDO1),
        (OWN.commands[0], objects.RPDO1_COMMUNICATION, objects.RPDO1_MAP, RPDO1),
    ],
)
def test_the_packaged_profile_is_what_our_drives_are(pdo, communication, index, layout):
    """Operator's side and device's side are stated apart, and agree."""
    entries = variables(node_dictionary(NODE))
    signed = {datatypes.INTEGER8: "b", datatypes.INTEGER16: "h", datatypes.INTEGER32: "l"}
    codes = signed | {
        datatypes.UNSIGNED8: "B",
        datatypes.UNSIGNED16: "H",
        datatypes.UNSIGNED32: "L",
    }
    assert entries[communication, 1].default & 0x7FF == pdo.cob_id
    assert layout.size * 8 == sum(bits for _, _, bits in pdo.entries)
    assert entries[index, 0].default == len(pdo.entries)
    for number, (object_index, sub, bits) in enumerate(pdo.entries, start=1):
        mapped = entries[object_index, sub]
        assert len(mapped) == bits
        assert mapped.pdo_mappable
        assert codes[mapped.data_type] == layout.format[number]
        assert entries[index, number].default == object_index << 16 | sub << 8 | bits


def test_nodes_do_not_share_what_they_are_given():
    first = node_dictionary(NODE)
    entry = first[objects.MAX_TORQUE]
    assert isinstance(entry, ODVariable)
    entry.default = 1
    assert variables(node_dictionary(NODE))[objects.MAX_TORQUE, 0].default == 1000
