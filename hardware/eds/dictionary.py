"""Object dictionaries for the `canopen` package, straight from the device descriptions. Knows no bus."""

from __future__ import annotations

from canopen import ObjectDictionary
from canopen.objectdictionary import ODArray, ODRecord, ODVariable

from hardware.eds.devices import JOINT, SUPERVISOR
from hardware.eds.model import Device, DictionaryObject, Entry, ObjectKind
from hardware.objects import SUPERVISOR_NODE


def node_dictionary(node: int) -> ObjectDictionary:
    """Dictionary of a node of the arm: the supervisor's, or a joint's."""
    return object_dictionary(SUPERVISOR if node == SUPERVISOR_NODE else JOINT, node)


def object_dictionary(device: Device, node: int) -> ObjectDictionary:
    """Dictionary of one device at a node number, as importing its EDS would give."""
    dictionary = ObjectDictionary()  # type: ignore[no-untyped-call]
    dictionary.node_id = node
    for item in device.objects:
        dictionary.add_object(_object(item, node))
    return dictionary


def _object(item: DictionaryObject, node: int) -> ODVariable | ODArray | ODRecord:
    if item.kind in (ObjectKind.VARIABLE, ObjectKind.DOMAIN):
        ((_, entry),) = item.entries
        return _variable(item.index, 0, entry, node)
    kind = ODArray if item.kind is ObjectKind.ARRAY else ODRecord
    group: ODArray | ODRecord = kind(item.name, item.index)
    for sub, entry in item.entries:
        group.add_member(_variable(item.index, sub, entry, node))
    return group


def _variable(index: int, sub: int, entry: Entry, node: int) -> ODVariable:
    made = ODVariable(entry.name, index, sub)
    made.data_type = int(entry.type)
    made.access_type = entry.access.value
    made.pdo_mappable = entry.mappable
    made.min, made.max = entry.lowest, entry.highest
    made.relative = entry.plus_node
    default: object = entry.default
    if entry.plus_node and isinstance(entry.default, int):
        default = entry.default + node
    made.default = default  # type: ignore[assignment]  # annotated int, holds text as well
    return made
