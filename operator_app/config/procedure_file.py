"""Reads and checks the procedure file (``sarcal/procedure/1``) and the files that it names."""

import difflib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from operator_app.config.arm_file import check_home, parse_arm
from operator_app.config.errors import ConfigError, Problem
from operator_app.config.fixture_file import parse_fixture
from operator_app.config.procedure import Procedure, ProcedureFile
from operator_app.config.profile_file import parse_profile
from operator_app.config.resources import Kind, Resource, resolve
from operator_app.config.schema import check_model
from operator_app.config.strict_yaml import Complaint, load_strict
from operator_app.config.strict_yaml import Path as KeyPath
from solver.arrays import frozen
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import Parameter

T = TypeVar("T")


def parse_procedure(
    source: Resource, *, snapshot: Mapping[Kind, Resource] | None = None
) -> Procedure:
    """Read a procedure with its arm, fixture and bus profile.

    A procedure names these files by built-in name or path; relative paths start from the procedure's folder. Files in
    `snapshot` (by kind) replace the named files. Raises ConfigError with all problems of the four files.
    """
    document = load_strict(source.data, source.file)
    sources, problems = dict[str, Resource](), list[Problem]()

    def read(
        kind: Kind, name: str, parse: Callable[[bytes, str], T], *, at: KeyPath = ()
    ) -> T | None:
        try:
            resource = (snapshot or {}).get(kind) or resolve(kind, name, folder=source.folder)
        except ConfigError as error:
            # The reference is wrong: report its place.
            for p in error.problems:
                text = f"{p.file}: {p.text}"
                problems.append(document.problem(at or (kind,), text, p.remedy))
            return None
        sources[kind] = resource
        try:
            return parse(resource.data, resource.file)
        except ConfigError as error:
            problems.extend(error.problems)
            return None

    try:
        file_model = check_model(ProcedureFile, document, kind="procedure")
    except ConfigError as error:
        # Read the other files anyway, to report all problems at once.
        if isinstance(name := document.data.get("arm"), str):
            read("arm", name, parse_arm)
        if isinstance(name := document.data.get("fixture"), str):
            read("fixture", name, parse_fixture)
        raise ConfigError((*error.problems, *problems)) from error
    arm = read("arm", file_model.arm, parse_arm)
    fixture = read("fixture", file_model.fixture, parse_fixture)
    for_arm = partial(parse_profile, joints=None if arm is None else arm.joint_count)
    profile = read("profile", file_model.bus.profile, for_arm, at=("bus", "profile"))
    complaints: list[Complaint] = []
    if arm is not None:
        complaints += _check_own(file_model, arm)
        arm = _as_here(file_model, arm)
    complaints += _check_joints(file_model, arm)
    if not (problems or complaints) and arm is not None and fixture is not None:
        loop = fixture.fixture.model(arm, unsensed_joints=file_model.unsensed_joints)
        complaints += _check_requested(file_model, loop.parameters)
    problems += (document.problem(*complaint) for complaint in complaints)
    if problems or arm is None or fixture is None or profile is None:
        raise ConfigError(problems)
    return Procedure(
        name=file_model.name,
        arm=arm,
        fixture=fixture,
        profile=profile,
        sources=(source, sources["arm"], sources["fixture"], sources["profile"]),
        bus=file_model.bus,
        position_joints=file_model.chosen_modes.listed or None,
        trial=file_model.chosen_modes.trial,
        unsensed_joints=file_model.unsensed_joints,
        capture=file_model.capture,
        estimator=file_model.estimator,
        acceptance=file_model.acceptance,
        upload=file_model.export.upload,
        held=file_model.held,
        tracker=file_model.tracker,
    )


def load_procedure(reference: str | Path) -> Procedure:
    """Read a procedure by built-in name or path; raises the same errors as `parse_procedure`."""
    return parse_procedure(resolve("procedure", reference))


def _as_here(file_model: ProcedureFile, arm: ArmModel) -> ArmModel:
    home = file_model.home_deg
    fits = home is not None and len(home) == arm.joint_count
    return replace(
        arm,
        free=tuple(entry for entry in arm.free if entry.name not in file_model.held),
        home_rad=frozen(np.deg2rad(home)) if home is not None and fits else arm.home_rad,
    )


def _check_joints(file_model: ProcedureFile, arm: ArmModel | None) -> Iterator[Complaint]:
    modes = file_model.chosen_modes
    drives, unsensed = modes.listed, file_model.unsensed_joints
    lists: tuple[tuple[KeyPath, tuple[int, ...]], ...]
    lists = ((("modes", "position"), drives), (("unsensed_joints",), unsensed))
    for path, joints in lists:
        for k, joint in enumerate(joints):
            if arm is not None and joint > arm.joint_count:
                text, remedy = f"there is no joint {joint}", f"joints are 1 to {arm.joint_count}"
                yield (*path, k), text, remedy
            elif joint in joints[:k]:
                text = f"joint {joint} is listed twice"
                yield (*path, k), text, "list each joint once"
    for k, joint in enumerate(drives):
        if joint in unsensed:
            text = f"joint {joint} is in position mode and unsensed"
            remedy = (
                "a joint whose reading is not used cannot be driven to a position: remove it from modes.position "
                "or from unsensed_joints"
            )
            yield ("modes", "position", k), text, remedy
    if modes.trial and drives:
        text = "has no effect, because modes.position lists the drive joints"
        remedy = "write position: auto to choose them by trial, or leave trial out"
        yield ("modes", "trial"), text, remedy
    yield from _check_exploration(file_model, drives, arm)
    if arm is not None:
        yield from _check_limits(file_model, arm)


def _check_own(file_model: ProcedureFile, arm: ArmModel) -> Iterator[Complaint]:
    if file_model.home_deg is not None:
        ranges = [(math.degrees(j.lower_rad), math.degrees(j.upper_rad)) for j in arm.joints]
        yield from check_home(file_model.home_deg, ranges)
    free = {entry.name for entry in arm.free}
    for name in file_model.held:
        if name not in free:
            remedy = f"leave it out; free are {', '.join(sorted(free))}"
            yield ("held", name), "is not a free entry of the arm: it is fixed anyway", remedy


def _check_exploration(
    file_model: ProcedureFile, drives: tuple[int, ...], arm: ArmModel | None
) -> Iterator[Complaint]:
    place: KeyPath = ("capture", "exploration")
    named = [item.joint for item in file_model.capture.exploration]
    for k, joint in enumerate(named):
        if joint in named[:k]:
            text = f"joint {joint} is listed twice"
            yield (*place, k, "joint"), text, "keep one of them"
        elif joint not in drives:
            text = f"joint {joint} is not in position mode"
            yield (*place, k, "joint"), text, "explore with the drive joints only"
    if file_model.capture.strategy == "planned":
        return
    for joint in sorted(set(drives) - set(named)):
        if arm is None or joint <= arm.joint_count:
            remedy = f"add {{joint: {joint}, from_deg: ..., to_deg: ...}}"
            yield place, f"joint {joint} has no exploration range", remedy


def _check_limits(file_model: ProcedureFile, arm: ArmModel) -> Iterator[Complaint]:
    ranges = enumerate(file_model.capture.exploration)
    boxes = [(k, item) for k, item in ranges if item.joint <= arm.joint_count]
    for k, item in boxes:
        joint, home = arm.joints[item.joint - 1], math.degrees(arm.home_rad[item.joint - 1])
        low, high = math.degrees(joint.lower_rad), math.degrees(joint.upper_rad)
        for key, end in (("from_deg", item.from_deg), ("to_deg", item.to_deg)):
            if not low - 1e-9 <= home + end <= high + 1e-9:
                way = f"joint {item.joint} from home {home:.6g} to {home + end:.6g} deg"
                text = f"takes {way}, outside its range {low:.6g} to {high:.6g} deg"
                yield ("capture", "exploration", k, key), text, "shorten the exploration range"
    # If the program chooses the drive joints, any joint may drive.
    named = [item.joint for _, item in boxes]
    drives = named if file_model.chosen_modes.listed else range(1, arm.joint_count + 1)
    slowest = min(drives, key=lambda j: arm.joints[j - 1].max_speed_rad_per_s, default=None)
    if slowest is not None:
        limit = math.degrees(arm.joints[slowest - 1].max_speed_rad_per_s)
        if file_model.capture.speed_deg_per_s > limit * (1.0 + 1e-9):
            text = f"exceeds the limit of joint {slowest} ({limit:.6g} deg/s)"
            yield ("capture", "speed_deg_per_s"), text, "reduce the speed"


def _check_requested(
    file_model: ProcedureFile, parameters: Sequence[Parameter]
) -> Iterator[Complaint]:
    place: KeyPath = ("capture", "requested_sigma")
    requested = file_model.capture.requested_sigma
    if requested and file_model.capture.strategy != "planned":
        remedy = "add `plan: planned` to capture, or remove this key"
        yield place, "only a planned capture uses it", remedy
    known = {f"{p.name}_{'deg' if p.is_angle else 'mm'}": p for p in parameters}
    for key in requested:
        if key in known:
            continue
        name, _, _ = key.rpartition("_")
        meant = [k for k, p in known.items() if p.name in (name, key)]
        meant = meant or difflib.get_close_matches(key, list(known), n=1)
        remedy = f"did you mean {meant[0]}?" if meant else f"known here: {', '.join(known)}"
        yield (*place, key), "is not a parameter of this calibration", remedy
