"""Object dictionaries of the joint drive and the supervisor. Knows what the objects are, not what they do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from hardware import objects
from hardware.eds.model import (
    Access,
    DataType,
    Device,
    DictionaryObject,
    Entry,
    ObjectKind,
    structure,
    variable,
)

_RO, _RW, _WO, _CONST = Access.READ_ONLY, Access.READ_WRITE, Access.WRITE_ONLY, Access.CONSTANT
_I8, _I16, _I32 = DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER32
_U8, _U16, _U32 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32
_TEXT = DataType.VISIBLE_STRING

ERROR_HISTORY: Final = 8
"""Entries of 1003h."""
_PER_MILLE = 1000


def _value(
    index: int,
    name: str,
    kind: DataType,
    access: Access = _RO,
    *,
    default: int | str | None = 0,
    plus_node: bool = False,
    lowest: int | None = None,
    highest: int | None = None,
    mappable: bool = False,
) -> DictionaryObject:
    return variable(
        index,
        Entry(
            name=name,
            type=kind,
            access=access,
            default=default,
            plus_node=plus_node,
            lowest=lowest,
            highest=highest,
            mappable=mappable,
        ),
    )


def _common(*, device_type: int, name: str, product: int) -> tuple[DictionaryObject, ...]:
    """What every CANopen device of ours has (CiA 301)."""
    watched = (objects.OPERATOR_NODE << 16) | round(objects.HEARTBEAT_TIMEOUT_S * 1e3)
    faults = (
        Entry(name=f"Standard error field {k}", type=_U32, default=0)
        for k in range(1, ERROR_HISTORY + 1)
    )
    return (
        _value(objects.DEVICE_TYPE, "Device type", _U32, _CONST, default=device_type),
        _value(objects.ERROR_REGISTER, "Error register", _U8, mappable=True),
        structure(
            objects.ERROR_FIELD,
            "Pre-defined error field",
            *faults,
            kind=ObjectKind.ARRAY,
            count_access=_RW,
            count=0,
        ),
        _value(
            objects.SYNC_COB_ID,
            "COB-ID SYNC message",
            _U32,
            _CONST,
            default=objects.COB_SYNC,
        ),
        _value(objects.DEVICE_NAME, "Manufacturer device name", _TEXT, _CONST, default=name),
        _value(
            objects.HARDWARE_VERSION,
            "Manufacturer hardware version",
            _TEXT,
            _CONST,
            default="virtual",
        ),
        _value(
            objects.SOFTWARE_VERSION, "Manufacturer software version", _TEXT, _CONST, default="1.0"
        ),
        _value(
            objects.EMCY_COB_ID,
            "COB-ID emergency message",
            _U32,
            _CONST,
            default=objects.COB_EMCY,
            plus_node=True,
        ),
        structure(
            objects.HEARTBEAT_CONSUMER,
            "Consumer heartbeat time",
            Entry(name="Operator", type=_U32, access=_RO, default=watched),
            kind=ObjectKind.ARRAY,
        ),
        _value(
            objects.HEARTBEAT_PRODUCER,
            "Producer heartbeat time",
            _U16,
            _CONST,
            default=round(objects.HEARTBEAT_PERIOD_S * 1e3),
        ),
        structure(
            objects.IDENTITY,
            "Identity object",
            Entry(name="Vendor-ID", type=_U32, access=_CONST, default=objects.VENDOR_ID),
            Entry(name="Product code", type=_U32, access=_CONST, default=product),
            Entry(name="Revision number", type=_U32, access=_CONST, default=objects.REVISION),
            Entry(name="Serial number", type=_U32, default=0),
        ),
        structure(
            objects.SDO_SERVER,
            "SDO server parameter",
            Entry(
                name="COB-ID client to server",
                type=_U32,
                access=_CONST,
                default=objects.COB_SDO_TO_SERVER,
                plus_node=True,
            ),
            Entry(
                name="COB-ID server to client",
                type=_U32,
                access=_CONST,
                default=objects.COB_SDO_FROM_SERVER,
                plus_node=True,
            ),
        ),
    )


def _pdo(
    communication: int, mapping: int, kind: str, cob: int, transmission: int, what: Sequence[int]
) -> tuple[DictionaryObject, ...]:
    """Communication and mapping of one fixed PDO."""
    mapped = (
        Entry(name=f"Mapped object {k}", type=_U32, access=_CONST, default=entry)
        for k, entry in enumerate(what, start=1)
    )
    return (
        structure(
            communication,
            f"{kind} communication parameter",
            Entry(
                name=f"COB-ID used by {kind}",
                type=_U32,
                access=_CONST,
                default=cob,
                plus_node=True,
            ),
            Entry(name="Transmission type", type=_U8, access=_CONST, default=transmission),
        ),
        structure(mapping, f"{kind} mapping parameter", *mapped),
    )


def _map(layout: Sequence[tuple[int, int, int]]) -> tuple[int, ...]:
    return tuple(index << 16 | sub << 8 | bits for index, sub, bits in layout)


def _drive() -> tuple[DictionaryObject, ...]:
    """CiA 402 axis: cyclic synchronous position and torque."""
    modes = 1 << (objects.CYCLIC_POSITION - 1) | 1 << (objects.CYCLIC_TORQUE - 1)
    period_ms = round(objects.CONTROL_PERIOD_S * 1e3)
    return (
        _value(objects.ERROR_CODE, "Error code", _U16, mappable=True),
        _value(objects.CONTROLWORD, "Controlword", _U16, _RW, mappable=True),
        _value(objects.STATUSWORD, "Statusword", _U16, mappable=True),
        _value(objects.QUICK_STOP_OPTION, "Quick stop option code", _I16, _CONST, default=6),
        _value(objects.MODE, "Modes of operation", _I8, _RW, mappable=True),
        _value(objects.MODE_DISPLAY, "Modes of operation display", _I8, mappable=True),
        _value(objects.POSITION_ACTUAL, "Position actual value", _I32, mappable=True),
        _value(objects.FOLLOWING_WINDOW, "Following error window", _U32),
        _value(objects.VELOCITY_ACTUAL, "Velocity actual value", _I32, mappable=True),
        _value(objects.TARGET_TORQUE, "Target torque", _I16, _RW, lowest=0, highest=0),
        _value(objects.MAX_TORQUE, "Max torque", _U16, _CONST, default=_PER_MILLE),
        _value(objects.RATED_TORQUE, "Motor rated torque", _U32),
        _value(objects.TORQUE_ACTUAL, "Torque actual value", _I16, mappable=True),
        _value(objects.TARGET_POSITION, "Target position", _I32, _RW, mappable=True),
        _value(objects.HOME_OFFSET, "Home offset", _I32),
        structure(
            objects.POSITION_LIMITS,
            "Software position limit",
            Entry(name="Min position limit", type=_I32, default=0),
            Entry(name="Max position limit", type=_I32, default=0),
            kind=ObjectKind.ARRAY,
        ),
        _value(objects.MAX_VELOCITY, "Max profile velocity", _U32),
        structure(
            objects.ENCODER_RESOLUTION,
            "Position encoder resolution",
            Entry(name="Encoder increments", type=_U32, default=1),
            Entry(name="Motor revolutions", type=_U32, default=1),
            kind=ObjectKind.ARRAY,
        ),
        structure(
            objects.CONTROL_PERIOD,
            "Interpolation time period",
            Entry(name="Time period value", type=_U8, access=_CONST, default=period_ms),
            Entry(name="Time index", type=_I8, access=_CONST, default=-3),
        ),
        _value(objects.SUPPORTED_MODES, "Supported drive modes", _U32, _CONST, default=modes),
        structure(
            objects.SENSOR,
            "Angle sensor",
            Entry(name="Kind", type=_U8, default=int(objects.SensorKind.NONE)),
            Entry(name="Full scale", type=_U32, default=0),
            Entry(name="Converter bits", type=_U8, default=0),
        ),
    )


def _supervisor() -> tuple[DictionaryObject, ...]:
    """Parameters and control token."""
    commands = [int(command) for command in objects.ParameterCommand]
    return (
        _value(objects.DOCUMENT, "Parameter document", DataType.DOMAIN, _RW, default=None),
        structure(
            objects.DIGEST,
            "Parameter document digest",
            Entry(name="SHA-256", type=DataType.OCTET_STRING),
            Entry(name="Length", type=_U32, default=0),
        ),
        _value(
            objects.COMMAND,
            "Parameter command",
            _U8,
            _WO,
            default=None,
            lowest=min(commands),
            highest=max(commands),
        ),
        structure(
            objects.SLOTS,
            "Parameter slots",
            Entry(name="Active slot", type=_U8, default=int(objects.Slot.NONE)),
            Entry(name="State of slot A", type=_U8, default=int(objects.SlotState.EMPTY)),
            Entry(name="State of slot B", type=_U8, default=int(objects.SlotState.EMPTY)),
            Entry(name="Staged", type=_U8, default=0),
        ),
        _value(objects.REFUSAL, "Last refusal", _TEXT, default=None),
        _value(objects.TOKEN, "Control token", _U32, _RW, lowest=0, highest=127),
        structure(
            objects.ARM,
            "Arm",
            Entry(name="Model", type=_TEXT),
            Entry(name="Serial number", type=_TEXT),
            Entry(name="Number of joints", type=_U8, default=0),
        ),
    )


JOINT: Final = Device(
    file_name="joint.eds",
    product_name=objects.JOINT_DEVICE_NAME,
    vendor_number=objects.VENDOR_ID,
    product_number=objects.JOINT_PRODUCT,
    revision_number=objects.REVISION,
    rx_pdos=1,
    tx_pdos=1,
    objects=(
        *_common(
            device_type=objects.DRIVE_DEVICE_TYPE,
            name=objects.JOINT_DEVICE_NAME,
            product=objects.JOINT_PRODUCT,
        ),
        *_pdo(
            objects.RPDO1_COMMUNICATION,
            objects.RPDO1_MAP,
            "RPDO1",
            objects.COB_RPDO1,
            objects.RPDO_ON_RECEIPT,
            _map(objects.RPDO1_MAPPING),
        ),
        *_pdo(
            objects.TPDO1_COMMUNICATION,
            objects.TPDO1_MAP,
            "TPDO1",
            objects.COB_TPDO1,
            objects.TPDO_EVERY_SYNC,
            _map(objects.TPDO1_MAPPING),
        ),
        *_drive(),
    ),
)
SUPERVISOR: Final = Device(
    file_name="supervisor.eds",
    product_name=objects.SUPERVISOR_DEVICE_NAME,
    vendor_number=objects.VENDOR_ID,
    product_number=objects.SUPERVISOR_PRODUCT,
    revision_number=objects.REVISION,
    rx_pdos=0,
    tx_pdos=0,
    objects=(
        *_common(
            device_type=objects.SUPERVISOR_DEVICE_TYPE,
            name=objects.SUPERVISOR_DEVICE_NAME,
            product=objects.SUPERVISOR_PRODUCT,
        ),
        *_supervisor(),
    ),
)
DEVICES: Final = (JOINT, SUPERVISOR)
