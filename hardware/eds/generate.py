"""Writes the EDS files (CiA 306) from the device descriptions: ``python -m hardware.eds.generate``.

Knows the file format only. With ``--check`` nothing is written, and the exit code is 1 if a file is
not what would be written now. The text depends on the descriptions alone: no clock, no user.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from hardware.eds.devices import DEVICES
from hardware.eds.model import Access, DataType, Device, DictionaryObject, Entry, ObjectKind

FOLDER: Final = Path(__file__).parent
_WRITTEN_DATE: Final = "11-21-2026"
_WRITTEN_TIME: Final = "08:00AM"
_AUTHOR: Final = "the sarcal authors"
_BAUD_RATES: Final = (10, 20, 50, 125, 250, 500, 800, 1000)
_MANDATORY: Final = frozenset({0x1000, 0x1001, 0x1018})
_MAKERS: Final = range(0x2000, 0x6000)
_HEX_DIGITS: Final = {
    DataType.UNSIGNED8: 2,
    DataType.UNSIGNED16: 4,
    DataType.UNSIGNED32: 8,
}
_NO_RANGE: Final = frozenset({DataType.VISIBLE_STRING, DataType.OCTET_STRING, DataType.DOMAIN})


def eds_text(device: Device) -> str:
    """Electronic data sheet of a device, as text with Unix line ends."""
    sections = [
        _section(
            "FileInfo",
            {
                "FileName": device.file_name,
                "FileVersion": 1,
                "FileRevision": 0,
                "EDSVersion": "4.0",
                "Description": device.product_name,
                "CreationTime": _WRITTEN_TIME,
                "CreationDate": _WRITTEN_DATE,
                "CreatedBy": _AUTHOR,
                "ModificationTime": _WRITTEN_TIME,
                "ModificationDate": _WRITTEN_DATE,
                "ModifiedBy": _AUTHOR,
            },
        ),
        _section(
            "DeviceInfo",
            {
                "VendorName": _AUTHOR,
                "VendorNumber": f"0x{device.vendor_number:08X}",
                "ProductName": device.product_name,
                "ProductNumber": f"0x{device.product_number:08X}",
                "RevisionNumber": f"0x{device.revision_number:08X}",
                "OrderCode": device.product_name,
                **{f"BaudRate_{rate}": 1 for rate in _BAUD_RATES},
                "SimpleBootUpMaster": 0,
                "SimpleBootUpSlave": 1,
                "Granularity": 0,
                "DynamicChannelsSupported": 0,
                "GroupMessaging": 0,
                "NrOfRXPDO": device.rx_pdos,
                "NrOfTXPDO": device.tx_pdos,
                "LSS_Supported": 0,
            },
        ),
        _section("DummyUsage", {f"Dummy{k:04X}": 0 for k in range(1, 8)}),
        _section("Comments", {"Lines": 1, "Line1": "Generated: python -m hardware.eds.generate"}),
    ]
    groups: dict[str, list[int]] = {
        "MandatoryObjects": [],
        "OptionalObjects": [],
        "ManufacturerObjects": [],
    }
    for item in device.objects:
        groups[_group(item.index)].append(item.index)
    for name, indices in groups.items():
        listed = {str(k): f"0x{index:04X}" for k, index in enumerate(sorted(indices), start=1)}
        sections.append(_section(name, {"SupportedObjects": len(indices), **listed}))
    for item in sorted(device.objects, key=lambda item: item.index):
        sections.extend(_object(item))
    return "\n".join(sections)


def stale(folder: Path = FOLDER) -> tuple[str, ...]:
    """Names of EDS files in a folder that are missing or not what would be written now."""
    return tuple(
        device.file_name
        for device in DEVICES
        if not (folder / device.file_name).is_file()
        or (folder / device.file_name).read_bytes() != eds_text(device).encode("ascii")
    )


def write(folder: Path = FOLDER) -> None:
    """Write all EDS files into a folder."""
    for device in DEVICES:
        (folder / device.file_name).write_bytes(eds_text(device).encode("ascii"))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--check", action="store_true", help="write nothing, compare")
    if parser.parse_args(arguments).check:
        names = stale()
        if names:
            sys.stderr.write(
                f"{', '.join(names)}: not as generated. Run: python -m hardware.eds.generate\n"
            )
        return 1 if names else 0
    write()
    return 0


def _group(index: int) -> str:
    if index in _MANDATORY:
        return "MandatoryObjects"
    return "ManufacturerObjects" if index in _MAKERS else "OptionalObjects"


def _object(item: DictionaryObject) -> list[str]:
    """Sections of one index."""
    name = f"{item.index:04X}"
    if item.kind in (ObjectKind.VARIABLE, ObjectKind.DOMAIN):
        ((_, entry),) = item.entries
        return [_section(name, _entry(entry, item.kind))]
    head: dict[str, str | int] = {
        "ParameterName": item.name,
        "ObjectType": f"0x{item.kind:02X}",
        "SubNumber": len(item.entries),
    }
    members = [
        _section(f"{name}sub{sub:X}", _entry(entry, ObjectKind.VARIABLE))
        for sub, entry in item.entries
    ]
    return [_section(name, head), *members]


def _entry(entry: Entry, kind: ObjectKind) -> dict[str, str | int]:
    lines: dict[str, str | int] = {
        "ParameterName": entry.name,
        "ObjectType": f"0x{kind:02X}",
        "DataType": f"0x{entry.type:04X}",
        "AccessType": entry.access.value,
    }
    if entry.type not in _NO_RANGE:
        if entry.lowest is not None:
            lines["LowLimit"] = entry.lowest
        if entry.highest is not None:
            lines["HighLimit"] = entry.highest
    if entry.default is not None:
        lines["DefaultValue"] = _default(entry)
    if entry.access is not Access.CONSTANT or entry.mappable:
        lines["PDOMapping"] = int(entry.mappable)
    return lines


def _default(entry: Entry) -> str:
    if isinstance(entry.default, str):
        return entry.default
    digits = _HEX_DIGITS.get(entry.type)
    value = str(entry.default) if digits is None else f"0x{entry.default:0{digits}X}"
    return f"$NODEID+{value}" if entry.plus_node else value


def _section(name: str, lines: dict[str, str | int]) -> str:
    return "\n".join([f"[{name}]", *(f"{key}={value}" for key, value in lines.items()), ""])


if __name__ == "__main__":
    sys.exit(main())
