"""Reads, checks and formats the bus profile (``sarcal/profile/1``): the set-up of an arm's nodes on the bus.

`ProfileFile` has the content of the file; `ProfileFile.for_joints` returns the profile for the hardware.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Literal

from pydantic import Field

from hardware.arm import JointMode
from hardware.canopen import bus_profile, objects
from hardware.canopen.drive_settings import DESCRIPTION_OBJECTS
from operator_app.config.atomic import dump_strict
from operator_app.config.errors import ConfigError
from operator_app.config.quantities import Count, Integer, Name, PositiveNumber, Text, in_form
from operator_app.config.resources import resolve
from operator_app.config.schema import StrictRecord, check_model
from operator_app.config.strict_yaml import Complaint, load_strict
from operator_app.config.strict_yaml import Path as KeyPath

_ENTRY = r"([0-9A-Fa-f]{4})h(?: sub (\d{1,3}))?\((\d{1,2})\)"
_COB_ID = r"([0-9A-Fa-f]{1,3})h( \+ node)?"
_HEXADECIMAL = r"([0-9A-Fa-f]{1,8})h"


MappedObject = Annotated[
    str, *in_form(_ENTRY, "mapped object", "write e.g. 6064h(32) or 2011h sub 3(16)")
]
CobId = Annotated[str, *in_form(_COB_ID, "identifier", "write e.g. 180h + node, or 1A3h")]
Hexadecimal = Annotated[str, *in_form(_HEXADECIMAL, "hexadecimal number", "write e.g. 00020192h")]
NodeNumber = Annotated[int, Field(strict=True, ge=1, le=objects.OPERATOR_NODE - 1)]
ModeCode = Annotated[int, Field(strict=True, ge=-128, le=127)]


def hexadecimal(text: str) -> int:
    """Return the value of a text such as ``00020192h``."""
    return int(text.removesuffix("h"), 16)


@dataclass(frozen=True, slots=True, kw_only=True)
class PdoSpec(StrictRecord):
    """One PDO: number, identifier (``180h + node``), and mapped objects with their bits (``6064h(32)``)."""

    pdo: Annotated[Count, Field(le=512)]
    cob_id: CobId
    map: Annotated[tuple[MappedObject, ...], Field(min_length=1, max_length=64)]

    @property
    def entries(self) -> tuple[bus_profile.Entry, ...]:
        """Index, sub-index and bits of each mapped object."""
        parts = (part for text in self.map for part in re.findall(_ENTRY, text))
        return tuple((int(index, 16), int(sub or 0), int(bits)) for index, sub, bits in parts)

    def at(self, node: int) -> bus_profile.Pdo:
        """Return this PDO for the drive with node number `node`, which is added to an identifier ``180h + node``."""
        match = re.fullmatch(_COB_ID, self.cob_id)
        base = 0 if match is None else int(match[1], 16) + (node if match[2] else 0)
        return bus_profile.Pdo(number=self.pdo, cob_id=base, entries=self.entries)


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSpec(StrictRecord):
    """Settings of one joint. Defaults: the node has the joint's number, and the PDOs common to all joints apply."""

    joint: Annotated[Count, Field(le=objects.MAX_JOINTS)]
    node: NodeNumber | None = None
    commands: tuple[PdoSpec, ...] = ()
    answers: tuple[PdoSpec, ...] = ()
    direction: Literal[-1, 1] = 1
    counts_per_rev: PositiveNumber | None = None
    zero_counts: Integer = 0
    rated_torque_nm: PositiveNumber | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceType(StrictRecord):
    """Object 1000h (device type) of a supported drive; only the bits of the mask are compared."""

    value: Hexadecimal
    mask: Hexadecimal


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeCodes(StrictRecord):
    """Values of object 6060h for position mode and for free mode."""

    position: ModeCode = objects.CYCLIC_POSITION
    free: ModeCode = objects.CYCLIC_TORQUE


@dataclass(frozen=True, slots=True, kw_only=True)
class HeartbeatLimits(StrictRecord):
    """Heartbeat limits: longest period, and the silence after which a node counts as lost."""

    slowest_ms: Annotated[Count, Field(le=bus_profile.MAX_HEARTBEAT_MS)] = (
        bus_profile.DEFAULT_HEARTBEAT_LIMIT_MS
    )
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
        value=f"{objects.DRIVE_DEVICE_TYPE:08X}h", mask=f"{objects.DEVICE_TYPE_MASK:08X}h"
    )
    modes: ModeCodes = ModeCodes()
    heartbeat: HeartbeatLimits = HeartbeatLimits()
    sdo_timeout_s: Annotated[PositiveNumber, Field(ge=0.05, le=60.0)] | None = None
    enabling_timeout_s: Annotated[PositiveNumber, Field(ge=0.1, le=60.0)] = (
        bus_profile.DEFAULT_ENABLING_TIMEOUT_S
    )

    def for_joints(self, count: int | None) -> bus_profile.BusProfile:
        """Return the profile of joints 1 to `count`.

        If None, `count` is the largest joint number in the file or, if no joint is listed, as many as the bus allows.
        """
        if count is None:
            listed = max((joint.joint for joint in self.joints), default=0)
            below = objects.MAX_JOINTS if self.supervisor == "none" else self.supervisor - 1
            count = listed or min(objects.MAX_JOINTS, below)
        modes = {JointMode.POSITION: self.modes.position, JointMode.FREE: self.modes.free}
        return bus_profile.BusProfile(
            name=self.name,
            joints=tuple(map(self._joint, range(1, count + 1))),
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

    def _joint(self, number: int) -> bus_profile.JointProfile:
        own = self.own(number)
        node = own.node or number
        return bus_profile.JointProfile(
            node=node,
            commands=tuple(pdo.at(node) for pdo in own.commands or self.commands),
            answers=tuple(pdo.at(node) for pdo in own.answers or self.answers),
            direction=own.direction,
            counts_per_rev=own.counts_per_rev,
            zero_counts=own.zero_counts,
            rated_torque_nm=own.rated_torque_nm,
        )


def parse_profile(data: bytes, file: str, *, joints: int | None) -> bus_profile.BusProfile:
    """Read a bus profile for an arm of `joints` joints; raises ConfigError with all problems of the file.

    None means the largest joint number in the file or, if no joint is listed, as many joints as the bus allows.
    """
    document = load_strict(data, file)
    file_model = check_model(ProfileFile, document, kind="profile")
    if complaints := list(_check_profile(file_model, joints)):
        raise ConfigError(document.problem(*complaint) for complaint in complaints)
    return file_model.for_joints(joints)


def load_profile(reference: str | Path, *, joints: int | None = None) -> bus_profile.BusProfile:
    """Read a bus profile by built-in name or path; raises the same errors as `parse_profile`."""
    resource = resolve("profile", reference)
    return parse_profile(resource.data, resource.file, joints=joints)


def format_profile(profile: bus_profile.BusProfile, *, comment: str) -> bytes:
    """Return a profile file with only name, supervisor or serial number, nodes, PDOs, `pdo_maps` and `compared`."""
    numbered = enumerate(profile.joints, 1)
    joints: list[dict[str, Any]] = [{"joint": k, "node": joint.node} for k, joint in numbered]
    shared: dict[str, Any] = {}
    for key in ("commands", "answers"):
        relative = [_written(getattr(j, key), j.node) for j in profile.joints]
        if all(pdos == relative[0] for pdos in relative):
            shared[key] = relative[0]
            continue
        for own, joint in zip(joints, profile.joints, strict=True):
            own[key] = _written(getattr(joint, key), None)
    arm: dict[str, Any] = {"supervisor": profile.supervisor}
    if profile.supervisor is None:
        arm = {"supervisor": "none", "serial_number": profile.serial_number}
    if profile.configures_pdos:
        arm["pdo_maps"] = "configured"
    data: dict[str, Any] = {
        "schema": "sarcal/profile/1",
        "name": profile.name,
        **arm,
        **shared,
        "joints": joints,
        "compared": [f"{index:04X}h" for index in sorted(profile.compared)],
    }
    return dump_strict(data, comment=comment)


def _written(pdos: Sequence[bus_profile.Pdo], node: int | None) -> list[dict[str, Any]]:
    """Return PDOs in the form of the file; their identifiers are relative to `node`, or absolute if `node` is None."""
    return [
        {
            "pdo": pdo.number,
            "cob_id": f"{pdo.cob_id - (node or 0):03X}h{'' if node is None else ' + node'}",
            "map": [bus_profile.format_entry(entry) for entry in pdo.entries],
        }
        for pdo in pdos
    ]


_RESERVED = (
    (0x000, 0x07F, "NMT, and kept free by CiA 301"),
    (0x080, 0x0FF, "SYNC and emergencies"),
    (0x580, 0x67F, "SDO"),
    (0x700, 0x7FF, "heartbeats"),
)


def _check_profile(file_model: ProfileFile, joints: int | None) -> Iterator[Complaint]:
    yield from _check_supervisor(file_model)
    yield from _check_listed(file_model, joints)
    if file_model.modes.position == file_model.modes.free:
        yield ("modes", "free"), "is the code of position mode as well", "give each mode its own"
    for k, text in enumerate(file_model.compared):
        if hexadecimal(text) not in DESCRIPTION_OBJECTS:
            known = ", ".join(f"{index:04X}h" for index in DESCRIPTION_OBJECTS)
            yield ("compared", k), f"{text} cannot be compared with an arm file", f"known: {known}"
    owners: list[tuple[KeyPath, ProfileFile | JointSpec]] = [((), file_model)]
    owners += ((("joints", k), joint) for k, joint in enumerate(file_model.joints))
    for place, owner in owners:
        for key in ("commands", "answers"):
            if pdos := getattr(owner, key):
                yield from _check_pdos((*place, key), pdos, sent=key == "answers")
    profile = file_model.for_joints(joints)
    for number, settings in enumerate(profile.joints, 1):
        for key in ("commands", "answers"):
            if not getattr(settings, key):
                remedy = f"give {key} for all joints, or its own"
                yield (key,), f"joint {number} has none", remedy
                return  # the other joints have the same problem
    yield from _check_unique(file_model, profile)


def _check_supervisor(file_model: ProfileFile) -> Iterator[Complaint]:
    if file_model.supervisor == "none":
        if file_model.serial_number is None:
            text = "is missing: without a supervisor only this file states which arm this is"
            yield ("serial_number",), text, "add it"
        return
    if file_model.serial_number is not None:
        yield ("serial_number",), "is stated by the supervisor", "leave it out"
    for k, joint in enumerate(file_model.joints):
        if (joint.direction, joint.counts_per_rev, joint.zero_counts) != (1, None, 0):
            text = "a supervisor sets home offsets (607Ch) in the counts of the arm file's sensor"
            remedy = (
                "leave direction, counts_per_rev and zero_counts out, or write supervisor: none"
            )
            yield ("joints", k), text, remedy


def _check_listed(file_model: ProfileFile, joints: int | None) -> Iterator[Complaint]:
    listed = set[int]()
    for k, joint in enumerate(file_model.joints):
        if joint.joint in listed:
            text = f"joint {joint.joint} is listed twice"
            yield ("joints", k, "joint"), text, "keep one of them"
        elif joints is not None and joint.joint > joints:
            text = f"there is no joint {joint.joint}"
            yield ("joints", k, "joint"), text, f"the arm's joints are 1 to {joints}"
        listed.add(joint.joint)


def _check_pdos(place: KeyPath, pdos: Sequence[PdoSpec], *, sent: bool) -> Iterator[Complaint]:
    required = bus_profile.FEEDBACK_OBJECTS if sent else bus_profile.COMMAND_OBJECTS
    times = dict.fromkeys(required, 0)
    width = dict.fromkeys(required, 0)
    for k, pdo in enumerate(pdos):
        key_path = (*place, k)
        if pdo.pdo in (other.pdo for other in pdos[:k]):
            yield (*key_path, "pdo"), f"PDO {pdo.pdo} is listed twice", "keep one of them"
        if sum(bits for _, _, bits in pdo.entries) > 64:
            yield (*key_path, "map"), "is longer than the 8 bytes of a frame", "correct the map"
        for m, (index, sub, bits) in enumerate(pdo.entries):
            at, shown = (*key_path, "map", m), bus_profile.format_entry((index, sub, bits))
            if index in required and sub == 0:
                times[index] += 1
                width[index] = max(width[index], bits)
                if bits not in bus_profile.FIELD_BITS:
                    remedy = f"as wide as {', '.join(map(str, bus_profile.FIELD_BITS))} bits"
                    yield at, f"{shown} cannot be read or written", remedy
            elif bits == 0 or bits % 8:
                yield at, f"{shown} is not a whole number of bytes", "map whole bytes in the drive"
            elif not sent and index not in bus_profile.ZERO_OBJECTS:
                text = f"{shown} is not an object that this program commands"
                yield at, text, "remove it from this RPDO, in the drive too"
    for index, count in times.items():
        if count == 0:
            yield place, f"nothing carries {index:04X}h", "map it, in the drive too"
        elif count > 1 and index != objects.CONTROLWORD and not sent:
            yield place, f"{index:04X}h is carried {count} times", "once is enough"
    if not sent and 0 < width[objects.TARGET_POSITION] < 32:
        text = f"{width[objects.TARGET_POSITION]} bits of target (607Ah) cannot hold every position"
        yield place, text, "map at least 32 bits"


def _check_unique(file_model: ProfileFile, profile: bus_profile.BusProfile) -> Iterator[Complaint]:
    places = {joint.joint: ("joints", k) for k, joint in enumerate(file_model.joints)}
    nodes = {} if profile.supervisor is None else {profile.supervisor: "the supervisor"}
    identifiers, reported = dict[int, str](), set[KeyPath]()
    for number, joint in enumerate(profile.joints, 1):
        place: KeyPath = places.get(number, ("joints",))
        if joint.node in nodes:
            key_path = (*place, "node") if number in places else place
            text = f"node {joint.node} is {nodes[joint.node]} and joint {number}"
            yield key_path, text, "give each its own number"
            return  # other problems may follow from this one
        nodes[joint.node] = f"joint {number}"
        for key, pdos in (("commands", joint.commands), ("answers", joint.answers)):
            own = bool(getattr(file_model.own(number), key))
            for k, pdo in enumerate(pdos):
                key_path = (*place, key, k, "cob_id") if own else (key, k, "cob_id")
                used = identifiers.get(pdo.cob_id) or next(
                    (what for low, high, what in _RESERVED if low <= pdo.cob_id <= high), ""
                )
                if used and key_path not in reported:  # common settings are reported once
                    reported.add(key_path)
                    text = f"{pdo.cob_id:03X}h, for joint {number}, is taken by {used}"
                    yield key_path, text, "choose another identifier, in the drive too"
                identifiers[pdo.cob_id] = f"joint {number}"
