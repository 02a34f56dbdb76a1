"""The bus profile (``sarcal/profile/1``): reads and checks it, and writes the draft of `sarcal probe`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from hardware.canopen.bus_profile import (
    COMMAND_OBJECTS,
    FEEDBACK_OBJECTS,
    FIELD_BITS,
    ZERO_OBJECTS,
    BusProfile,
    Pdo,
    format_entry,
)
from hardware.canopen.drive_settings import DESCRIPTION_OBJECTS
from hardware.canopen.objects import CONTROLWORD, TARGET_POSITION
from operator_app.config.atomic import dump_strict
from operator_app.config.errors import ConfigError
from operator_app.config.profile import JointSpec, PdoSpec, ProfileFile, hexadecimal
from operator_app.config.resources import resolve
from operator_app.config.schema import check_model
from operator_app.config.strict_yaml import Complaint, load_strict
from operator_app.config.strict_yaml import Path as KeyPath


def parse_profile(data: bytes, file: str, *, joints: int | None) -> BusProfile:
    """Read a bus profile for an arm of `joints` joints; for None, see `ProfileFile.for_joints`.

    Raises ConfigError with all problems of the file.
    """
    document = load_strict(data, file)
    file_model = check_model(ProfileFile, document, kind="profile")
    if complaints := list(check_profile(file_model, joints)):
        raise ConfigError(document.problem(*complaint) for complaint in complaints)
    return file_model.for_joints(joints)


def load_profile(reference: str | Path, *, joints: int | None = None) -> BusProfile:
    """Read a bus profile by built-in name or path; raises the same errors as `parse_profile`."""
    resource = resolve("profile", reference)
    return parse_profile(resource.data, resource.file, joints=joints)


def format_profile(profile: BusProfile, *, comment: str) -> bytes:
    """Format a profile so that reading it gives the same profile; settings common to all joints are written once."""
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


def _written(pdos: Sequence[Pdo], node: int | None) -> list[dict[str, Any]]:
    """Return PDOs as in the file, with identifiers relative to `node`, or absolute if `node` is None."""
    return [
        {
            "pdo": pdo.number,
            "cob_id": f"{pdo.cob_id - (node or 0):03X}h{'' if node is None else ' + node'}",
            "map": [format_entry(entry) for entry in pdo.entries],
        }
        for pdo in pdos
    ]


_RESERVED = (
    (0x000, 0x07F, "NMT, and kept free by CiA 301"),
    (0x080, 0x0FF, "SYNC and emergencies"),
    (0x580, 0x67F, "SDO"),
    (0x700, 0x7FF, "heartbeats"),
)


def check_profile(file_model: ProfileFile, joints: int | None) -> Iterator[Complaint]:
    """Yield all problems of a profile for an arm of `joints` joints, or of any number of joints if `joints` is None."""
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
        if owner.commands:
            yield from _check_pdos((*place, "commands"), owner.commands, sent=False)
        if owner.answers:
            yield from _check_pdos((*place, "answers"), owner.answers, sent=True)
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
        if joint.counts_otherwise:
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
    required = FEEDBACK_OBJECTS if sent else COMMAND_OBJECTS
    times = dict.fromkeys(required, 0)
    width = dict.fromkeys(required, 0)
    for k, pdo in enumerate(pdos):
        key_path = (*place, k)
        if pdo.pdo in (other.pdo for other in pdos[:k]):
            yield (*key_path, "pdo"), f"PDO {pdo.pdo} is listed twice", "keep one of them"
        if sum(bits for _, _, bits in pdo.entries) > 64:
            yield (*key_path, "map"), "is longer than the 8 bytes of a frame", "correct the map"
        for m, (index, sub, bits) in enumerate(pdo.entries):
            at, shown = (*key_path, "map", m), format_entry((index, sub, bits))
            if index in required and sub == 0:
                times[index] += 1
                width[index] = max(width[index], bits)
                if bits not in FIELD_BITS:
                    remedy = f"as wide as {', '.join(map(str, FIELD_BITS))} bits"
                    yield at, f"{shown} cannot be read or written", remedy
            elif bits == 0 or bits % 8:
                yield at, f"{shown} is not a whole number of bytes", "map whole bytes in the drive"
            elif not sent and index not in ZERO_OBJECTS:
                text = f"{shown} is not an object that this program commands"
                yield at, text, "remove it from this RPDO, in the drive too"
    for index, count in times.items():
        if count == 0:
            yield place, f"nothing carries {index:04X}h", "map it, in the drive too"
        elif count > 1 and index != CONTROLWORD and not sent:
            yield place, f"{index:04X}h is carried {count} times", "once is enough"
    if not sent and 0 < width[TARGET_POSITION] < 32:
        text = f"{width[TARGET_POSITION]} bits of target (607Ah) cannot hold every position"
        yield place, text, "map at least 32 bits"


def _check_unique(file_model: ProfileFile, profile: BusProfile) -> Iterator[Complaint]:
    """Check that no node and no identifier is used twice."""
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
