"""The bus profile (``sarcal/profile/1``): read, and written as `sarcal probe` drafts it. Knows no bus."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hardware.canopen.bus_profile import BusProfile, Pdo, format_entry
from operator_app.config.errors import ConfigError
from operator_app.config.profile import ProfileFile
from operator_app.config.profile_checks import check_profile
from operator_app.config.resources import resolve
from operator_app.config.schema import check_model
from operator_app.config.strict_yaml import load_strict
from operator_app.config.yaml_writer import dump_strict


def parse_profile(data: bytes, file: str, *, joints: int | None) -> BusProfile:
    """Read a bus profile for an arm of `joints` joints; None: for as many as it has room for.

    Raises
    ------
    ConfigError
        With all that is wrong.
    """
    document = load_strict(data, file)
    found = check_model(ProfileFile, document, kind="profile")
    problems = [document.problem(*complaint) for complaint in check_profile(found, joints)]
    if problems:
        raise ConfigError(problems)
    return found.for_joints(joints)


def load_profile(reference: str | Path, *, joints: int | None = None) -> BusProfile:
    """Read a bus profile by built-in name or path; raises as `parse_profile`."""
    found = resolve("profile", reference)
    return parse_profile(found.data, found.file, joints=joints)


def format_profile(profile: BusProfile, *, comment: str) -> bytes:
    """Write a profile so that it reads back the same, what all joints have in common once."""
    shared = {
        key: _relative(getattr(profile.joints[0], key), profile.drives[0])
        for key in ("commands", "answers")
        if len({str(_relative(getattr(j, key), j.node)) for j in profile.joints}) == 1
    }
    joints = []
    for number, joint in enumerate(profile.joints, 1):
        own: dict[str, Any] = {"joint": number, "node": joint.node}
        own |= {
            key: _absolute(getattr(joint, key))
            for key in ("commands", "answers")
            if key not in shared
        }
        joints.append(own)
    data: dict[str, Any] = {
        "schema": "sarcal/profile/1",
        "name": profile.name,
        "supervisor": "none" if profile.supervisor is None else profile.supervisor,
    }
    if profile.supervisor is None:
        data["serial_number"] = profile.serial_number
    if profile.configures_pdos:
        data["pdo_maps"] = "configured"
    data |= shared
    data["joints"] = joints
    data["compared"] = [f"{index:04X}h" for index in sorted(profile.compared)]
    return dump_strict(data, comment=comment)


def _relative(pdos: Sequence[Pdo], node: int) -> list[dict[str, Any]]:
    return [_written(pdo, f"{pdo.cob_id - node:03X}h + node") for pdo in pdos]


def _absolute(pdos: Sequence[Pdo]) -> list[dict[str, Any]]:
    return [_written(pdo, f"{pdo.cob_id:03X}h") for pdo in pdos]


def _written(pdo: Pdo, cob_id: str) -> dict[str, Any]:
    return {"pdo": pdo.number, "cob_id": cob_id, "map": [format_entry(e) for e in pdo.entries]}
