from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import canopen
import pytest
from canopen.objectdictionary import ODVariable

from hardware import objects
from hardware.eds.devices import DEVICES, JOINT
from hardware.eds.dictionary import node_dictionary, object_dictionary
from hardware.eds.generate import FOLDER, eds_text, main, stale, write
from hardware.eds.model import Device

NODE = 3
BY_NAME = pytest.mark.parametrize("device", DEVICES, ids=lambda device: device.file_name)


def _variables(dictionary: canopen.ObjectDictionary) -> dict[tuple[int, int], ODVariable]:
    found: dict[tuple[int, int], ODVariable] = {}
    for index, item in dictionary.indices.items():
        if isinstance(item, ODVariable):
            found[index, 0] = item
        else:
            found.update({(index, sub): item.subindices[sub] for sub in item.subindices})
    return found


def test_the_files_in_the_repository_are_what_the_generator_makes_now() -> None:
    assert stale() == ()
    assert main(["--check"]) == 0


def test_a_changed_or_missing_file_is_noticed(tmp_path: Path) -> None:
    write(tmp_path)
    assert stale(tmp_path) == ()
    changed = tmp_path / "joint.eds"
    changed.write_text(changed.read_text().replace("AccessType=rw", "AccessType=ro", 1))
    (tmp_path / "supervisor.eds").unlink()
    assert stale(tmp_path) == ("joint.eds", "supervisor.eds")


@BY_NAME
def test_dcfchk_finds_nothing(device: Device) -> None:
    here = shutil.which("dcfchk", path=f"{sysconfig.get_path('scripts')}{os.pathsep}{os.defpath}")
    if here is None:
        pytest.skip("dcfchk is not installed (pip install dcf-tools)")
    done = subprocess.run(
        [sys.executable, "-W", "error", here, "-n", str(NODE), str(FOLDER / device.file_name)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@BY_NAME
def test_importing_the_file_gives_the_dictionary_built_directly(device: Device) -> None:
    imported = _variables(canopen.import_od(str(FOLDER / device.file_name), NODE))
    built = _variables(object_dictionary(device, NODE))
    assert imported.keys() == built.keys()
    for key, ours in built.items():
        theirs = imported[key]
        for name in ("name", "data_type", "access_type", "default", "pdo_mappable", "min", "max"):
            assert getattr(theirs, name) == getattr(ours, name), (key, name)


@BY_NAME
def test_every_section_is_listed_once(device: Device) -> None:
    lines = eds_text(device).splitlines()
    heads = [line for line in lines if line.startswith("[")]
    assert len(heads) == len(set(heads))
    indices = [item.index for item in device.objects]
    assert len(indices) == len(set(indices))


@pytest.mark.parametrize(
    ("mapping", "layout", "index"),
    [
        (objects.TPDO1_MAPPING, objects.TPDO1, objects.TPDO1_MAP),
        (objects.RPDO1_MAPPING, objects.RPDO1, objects.RPDO1_MAP),
    ],
)
def test_pdo_layout_matches_the_mapped_objects(mapping, layout, index) -> None:  # type: ignore[no-untyped-def]
    variables = _variables(object_dictionary(JOINT, NODE))
    assert layout.size * 8 == sum(bits for _, _, bits in mapping)
    for number, (object_index, sub, bits) in enumerate(mapping, start=1):
        mapped = variables[object_index, sub]
        assert len(mapped) == bits
        assert mapped.pdo_mappable
        assert variables[index, number].default == object_index << 16 | sub << 8 | bits


def test_node_numbers_reach_the_cob_ids() -> None:
    variables = _variables(node_dictionary(5))
    assert variables[objects.TPDO1_COMMUNICATION, 1].default == 0x185
    assert variables[objects.RPDO1_COMMUNICATION, 1].default == 0x205
    assert variables[objects.EMCY_COB_ID, 0].default == 0x85
    assert (objects.TOKEN, 0) in _variables(node_dictionary(objects.SUPERVISOR_NODE))
    assert (objects.TOKEN, 0) not in variables
