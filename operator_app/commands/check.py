"""`sarcal check`: lists all problems of files; if there are none, states whether a calibration can succeed."""

import argparse
from itertools import product

from operator_app.calibration.experiment import Experiment
from operator_app.commands.table import FILE_ARGUMENTS
from operator_app.config.any_file import AnyKind, FilesRead, read_files
from operator_app.config.errors import ConfigError, Problem
from operator_app.config.fixture_file import FixtureSpec
from operator_app.config.poses_file import LIMIT_BYTES, LoadedPoses
from operator_app.config.procedure import Procedure
from operator_app.config.resources import (
    Resource,
    builtin_names,
    exists,
    expanded,
    read_limited,
    resolve,
)
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.planning import feasibility
from operator_app.planning.proposals import closing_home
from operator_app.report.results.check import check_json, check_text, problems_text
from operator_app.safe_output import as_json, say
from solver.chain.arm_model import ArmModel
from solver.diagnostics.identifiability import Identifiability
from solver.diagnostics.range_checks import range_findings
from solver.errors import SolverError


def execute(args: argparse.Namespace) -> int:
    """Check the files and print the result."""
    missing: list[Problem] = []
    sources: list[tuple[Resource, AnyKind | None]] = []
    named: list[tuple[AnyKind | None, str]] = [(None, file) for file in args.files]
    named += [(kind, name) for kind in FILE_ARGUMENTS if (name := getattr(args, kind))]
    for kind, name in named:
        try:
            sources.append((_read(kind, name), kind))
        except ConfigError as error:
            missing += error.problems
    if not sources and not missing:
        raise UsageError("name a file, e.g. sarcal check my_arm.yaml my_hinge.yaml")
    files = read_files(sources, missing)
    chains = () if files.problems else _chains(files)
    if args.json:
        say(as_json(check_json(files, chains)))
    else:
        say(problems_text(files.problems) if files.problems else check_text(files, chains))
    if files.problems:
        return ExitCode.BAD_INPUT
    refused = any(chain.refused for chain in chains)
    return ExitCode.NOT_IDENTIFIABLE if refused else ExitCode.ACCEPTED


def _read(kind: AnyKind | None, name: str) -> Resource:
    """Read a file; the name of a built-in file raises UsageError, unless `kind` is arm, fixture or procedure."""
    if kind in FILE_ARGUMENTS:
        return resolve(kind, name)
    builtin, path = [k for k in FILE_ARGUMENTS if name in builtin_names(k)], expanded(name)
    if builtin and not exists(path):
        options = " or ".join(f"--{k} {name}" for k in builtin)
        raise UsageError(
            f"{name} is not a file but a built-in {' and '.join(builtin)}: use {options}"
        )
    data = read_limited(path, name, limit=LIMIT_BYTES)
    return Resource(file=name, folder=path.parent, data=data)


def _chains(files: FilesRead) -> tuple[feasibility.Chain, ...]:
    """Assess each procedure's arm and fixture or, if no procedure is given, every arm with every fixture."""
    if procedures := files.of(Procedure):
        return tuple(_chain(files, p.arm, p.fixture, p) for p in procedures)
    pairs = product(files.of(ArmModel), files.of(FixtureSpec))
    return tuple(_chain(files, arm, fixture) for arm, fixture in pairs)


def _chain(
    files: FilesRead, arm: ArmModel, spec: FixtureSpec, procedure: Procedure | None = None
) -> feasibility.Chain:
    drives = None if procedure is None else procedure.position_joints
    unsensed = () if procedure is None else procedure.unsensed_joints
    identified: list[tuple[str, Identifiability]] = []
    unfit: list[tuple[str, str]] = []
    for read in files.files:
        file, loaded = read.source.file, read.content
        if not isinstance(loaded, LoadedPoses) or loaded.poses.q_rad.shape[1] != arm.joint_count:
            continue
        experiment = Experiment(
            arm=arm, fixture=spec.fixture, poses=loaded.poses, unsensed=unsensed
        )
        try:
            range_findings(arm, loaded.poses, unsensed_joints=unsensed)
            identified.append((file, feasibility.identifiability_of_poses(experiment)))
        except (SolverError, ValueError) as error:
            unfit.append((file, str(error)))
    prospect = feasibility.assess_feasibility(
        arm, spec.fixture, position_joints=drives, unsensed_joints=unsensed
    )
    return feasibility.Chain(
        arm=arm,
        fixture=spec,
        feasibility=prospect,
        home=closing_home(
            arm, spec.fixture, prospect, position_joints=drives, unsensed_joints=unsensed
        ),
        procedure="" if procedure is None else procedure.name,
        held={} if procedure is None else procedure.held,
        poses=tuple(identified),
        unfit=tuple(unfit),
    )
