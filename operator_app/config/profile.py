"""A bus profile (``sarcal/profile/1``): set-up of an arm's nodes.

`ProfileFile` has the content of the file; `ProfileFile.for_joints` returns the profile for the hardware.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, StringConstraints, WithJsonSchema

from hardware.arm import JointMode
from hardware.canopen.bus_profile import (
    DEFAULT_ENABLING_TIMEOUT_S,
    DEFAULT_HEARTBEAT_LIMIT_MS,
    MAX_HEARTBEAT_MS,
    BusProfile,
    Entry,
    JointProfile,
    Pdo,
)
from hardware.canopen.objects import (
    CYCLIC_POSITION,
    CYCLIC_TORQUE,
    DEVICE_TYPE_MASK,
    DRIVE_DEVICE_TYPE,
    MAX_JOINTS,
    OPERATOR_NODE,
)
from operator_app.config.quantities import Count, Integer, Name, PositiveNumber, Text, refuse
from operator_app.config.schema import StrictRecord

_ENTRY = r"([0-9A-Fa-f]{4})h(?: sub (\d{1,3}))?\((\d{1,2})\)"
_COB_ID = r"([0-9A-Fa-f]{1,3})h( \+ node)?"
_HEXADECIMAL = r"([0-9A-Fa-f]{1,8})h"


def _form(
    pattern: str, what: str, example: str
) -> tuple[StringConstraints, object, WithJsonSchema]:
    """Return annotations of a text that must match `pattern`; an error calls the text `what` and shows `example`."""

    def check(text: str) -> str:
        if not re.fullmatch(pattern, text):
            raise refuse(f"{text[:40]!r} is not a valid {what}", f"write e.g. {example}")
        return text

    schema = {"type": "string", "pattern": f"^{pattern}$"}
    return StringConstraints(strict=True), AfterValidator(check), WithJsonSchema(schema)


MappedObject = Annotated[str, *_form(_ENTRY, "mapped object", "6064h(32) or 2011h sub 3(16)")]
CobId = Annotated[str, *_form(_COB_ID, "identifier", "180h + node, or 1A3h")]
Hexadecimal = Annotated[str, *_form(_HEXADECIMAL, "hexadecimal number", "00020192h")]
NodeNumber = Annotated[int, Field(strict=True, ge=1, le=OPERATOR_NODE - 1)]
ModeCode = Annotated[int, Field(strict=True, ge=-128, le=127)]


def hexadecimal(text: str) -> int:
    """Return the value of a text such as ``00020192h``."""
    return int(text.removesuffix("h"), 16)


@dataclass(frozen=True, slots=True, kw_only=True)
class PdoSpec(StrictRecord):
    """One PDO: its number, its identifier (``180h + node``), and its objects (``6064h(32)``)."""

    pdo: Annotated[Count, Field(le=512)]
    cob_id: CobId
    map: Annotated[tuple[MappedObject, ...], Field(min_length=1, max_length=64)]

    @property
    def entries(self) -> tuple[Entry, ...]:
        """Index, sub-index and bits of each mapped object."""
        matches = [re.fullmatch(_ENTRY, text) for text in self.map]
        return tuple((int(m[1], 16), int(m[2] or 0), int(m[3])) for m in matches if m is not None)

    def at(self, node: int) -> Pdo:
        """Return the PDO of one node."""
        match = re.fullmatch(_COB_ID, self.cob_id)
        base = 0 if match is None else int(match[1], 16) + (node if match[2] else 0)
        return Pdo(number=self.pdo, cob_id=base, entries=self.entries)


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSpec(StrictRecord):
    """Settings of one joint; settings that are not stated are as for all joints."""

    joint: Annotated[Count, Field(le=MAX_JOINTS)]
    node: NodeNumber | None = None
    commands: tuple[PdoSpec, ...] = ()
    answers: tuple[PdoSpec, ...] = ()
    direction: Literal[-1, 1] = 1
    counts_per_rev: PositiveNumber | None = None
    zero_counts: Integer = 0
    rated_torque_nm: PositiveNumber | None = None

    @property
    def counts_otherwise(self) -> bool:
        """Whether the drive's direction, counts per turn or zero differ from the sensor in the arm file."""
        return (self.direction, self.counts_per_rev, self.zero_counts) != (1, None, 0)


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceType(StrictRecord):
    """Object 1000h (device type) of a supported drive; only the bits of the mask are compared."""

    value: Hexadecimal
    mask: Hexadecimal


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeCodes(StrictRecord):
    """Values of object 6060h for position mode and for free mode."""

    position: ModeCode = CYCLIC_POSITION
    free: ModeCode = CYCLIC_TORQUE


@dataclass(frozen=True, slots=True, kw_only=True)
class HeartbeatLimits(StrictRecord):
    """Heartbeat limits: longest period, and the silence after which a node counts as lost."""

    slowest_ms: Annotated[Count, Field(le=MAX_HEARTBEAT_MS)] = DEFAULT_HEARTBEAT_LIMIT_MS
    silent_after_s: Annotated[PositiveNumber, Field(ge=0.2, le=60.0)] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ProfileFile(StrictRecord):
    """Content of a bus profile file, without the key ``schema``.

    Attributes
    ----------
    pdo_maps
        ``compared``: a drive with different PDOs is refused. ``configured``: the PDOs are written into the drive at
        every connection before anything is enabled, but not stored there.
    """

    name: Name
    supervisor: Literal["none"] | NodeNumber
    serial_number: Text | None = None
    commands: tuple[PdoSpec, ...] = ()
    answers: tuple[PdoSpec, ...] = ()
    joints: tuple[JointSpec, ...] = ()
    pdo_maps: Literal["compared", "configured"] = "compared"
    compared: tuple[Hexadecimal, ...] = ()
    device_type: DeviceType = DeviceType(
        value=f"{DRIVE_DEVICE_TYPE:08X}h", mask=f"{DEVICE_TYPE_MASK:08X}h"
    )
    modes: ModeCodes = ModeCodes()
    heartbeat: HeartbeatLimits = HeartbeatLimits()
    sdo_timeout_s: Annotated[PositiveNumber, Field(ge=0.05, le=60.0)] | None = None
    enabling_timeout_s: Annotated[PositiveNumber, Field(ge=0.1, le=60.0)] = (
        DEFAULT_ENABLING_TIMEOUT_S
    )

    def for_joints(self, count: int | None = None) -> BusProfile:
        """Return the profile for `count` joints (None: up to the highest listed, or all if no joint is listed)."""
        if count is None:
            listed = max((joint.joint for joint in self.joints), default=0)
            room = MAX_JOINTS if self.supervisor == "none" else min(MAX_JOINTS, self.supervisor - 1)
            count = listed or room
        modes = {JointMode.POSITION: self.modes.position, JointMode.FREE: self.modes.free}
        return BusProfile(
            name=self.name,
            joints=tuple(self._joint(j, self.own(j)) for j in range(1, count + 1)),
            supervisor=None if self.supervisor == "none" else self.supervisor,
            serial_number=self.serial_number or "",
            device_type=hexadecimal(self.device_type.value),
            device_type_mask=hexadecimal(self.device_type.mask),
            mode_codes=MappingProxyType(modes),
            configures_pdos=self.pdo_maps == "configured",
            compared=frozenset(map(hexadecimal, self.compared)),
            slowest_heartbeat_ms=self.heartbeat.slowest_ms,
            enabling_timeout_s=self.enabling_timeout_s,
            heartbeat_timeout_s=self.heartbeat.silent_after_s,
            sdo_timeout_s=self.sdo_timeout_s,
        )

    def own(self, number: int) -> JointSpec:
        """Return the settings of one joint; the default settings if the file does not list the joint."""
        return next((j for j in self.joints if j.joint == number), JointSpec(joint=number))

    def _joint(self, number: int, own: JointSpec) -> JointProfile:
        node = own.node or number
        return JointProfile(
            node=node,
            commands=tuple(pdo.at(node) for pdo in own.commands or self.commands),
            answers=tuple(pdo.at(node) for pdo in own.answers or self.answers),
            direction=own.direction,
            counts_per_rev=own.counts_per_rev,
            zero_counts=own.zero_counts,
            rated_torque_nm=own.rated_torque_nm,
        )
