"""The procedure file (``sarcal/procedure/1``), read with the files it names. Knows no bus."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

from operator_app.config.arm_file import parse_arm
from operator_app.config.errors import ConfigError, Problem
from operator_app.config.fixture_file import parse_fixture
from operator_app.config.procedure import Procedure, ProcedureFile
from operator_app.config.procedure_checks import check_joints, check_own, check_requested
from operator_app.config.profile_file import parse_profile
from operator_app.config.resources import Kind, Resource, resolve
from operator_app.config.schema import check_model
from operator_app.config.strict_yaml import load_strict
from operator_app.config.yaml_document import Path as KeyPath
from operator_app.config.yaml_document import YamlDocument
from solver.arrays import frozen
from solver.chain.arm_model import ArmModel

T = TypeVar("T")


def parse_procedure(
    source: Resource, *, snapshot: Mapping[Kind, Resource] | None = None
) -> Procedure:
    """Read a procedure and the arm, the fixture and the bus profile it names.

    Names are built-in names or paths; relative paths start from the procedure's own folder. The files in
    a `snapshot` are taken instead, whatever the procedure names.

    Raises
    ------
    ConfigError
        With all that is wrong in any of the four files.
    """
    document = load_strict(source.data, source.file)
    problems: list[Problem] = []
    known = snapshot or {}
    try:
        found = check_model(ProcedureFile, document, kind="procedure")
    except ConfigError as error:
        # What it names is read all the same: one run tells all that is wrong.
        named: dict[Kind, Callable[[bytes, str], object]] = {
            "arm": parse_arm,
            "fixture": parse_fixture,
        }
        for kind, parse in named.items():
            if isinstance(document.data.get(kind), str):
                _referred(kind, document, source, known, parse=parse, problems=problems)
        raise ConfigError((*error.problems, *problems)) from error
    arm = _referred("arm", document, source, known, parse=parse_arm, problems=problems)
    fixture = _referred("fixture", document, source, known, parse=parse_fixture, problems=problems)
    profile = _referred(
        "profile",
        document,
        source,
        known,
        parse=partial(parse_profile, joints=None if arm is None else arm[1].joint_count),
        problems=problems,
        at=("bus", "profile"),
        name=found.bus.profile,
    )
    if arm is not None:
        problems += check_own(found, arm[1], document)
        arm = arm[0], _as_here(found, arm[1])
    problems += check_joints(found, None if arm is None else arm[1], document)
    if not problems and arm is not None and fixture is not None:
        loop = fixture[1].fixture.model(arm[1], unsensed_joints=found.unsensed_joints)
        problems += check_requested(found, loop.parameters, document)
    if problems or arm is None or fixture is None or profile is None:
        raise ConfigError(problems)
    return Procedure(
        name=found.name,
        arm=arm[1],
        fixture=fixture[1],
        profile=profile[1],
        sources=(source, arm[0], fixture[0], profile[0]),
        bus=found.bus,
        position_joints=found.chosen_modes.listed or None,
        trial=found.chosen_modes.trial,
        unsensed_joints=found.unsensed_joints,
        capture=found.capture,
        estimator=found.estimator,
        acceptance=found.acceptance,
        upload=found.export.upload,
        held=found.held,
        tracker=found.tracker,
    )


def load_procedure(reference: str | Path) -> Procedure:
    """Read a procedure by built-in name or path; raises as `parse_procedure`."""
    return parse_procedure(resolve("procedure", reference))


def _as_here(found: ProcedureFile, arm: ArmModel) -> ArmModel:
    """Return the arm with this procedure's home, and without the free entries that it holds."""
    home = found.home_deg
    fits = home is not None and len(home) == arm.joint_count
    return replace(
        arm,
        free=tuple(entry for entry in arm.free if entry.name not in found.held),
        home_rad=frozen(np.deg2rad(home)) if home is not None and fits else arm.home_rad,
    )


def _referred(
    kind: Kind,
    document: YamlDocument,
    source: Resource,
    known: Mapping[Kind, Resource],
    *,
    parse: Callable[[bytes, str], T],
    problems: list[Problem],
    at: KeyPath = (),
    name: str = "",
) -> tuple[Resource, T] | None:
    """File that the procedure names, under the key `kind` unless told otherwise.

    What is wrong with it goes to `problems`.
    """
    try:
        named = name or str(document.data[kind])
        found = known.get(kind) or resolve(kind, named, folder=source.folder)
    except ConfigError as error:
        # The reference is what is wrong: say where it stands.
        problems += (
            document.problem(at or (kind,), f"{p.file}: {p.text}", p.remedy) for p in error.problems
        )
        return None
    try:
        return found, parse(found.data, found.file)
    except ConfigError as error:
        problems += error.problems
        return None
