"""`sarcal check`: lists all problems of files or, if none, states whether a calibration with them can succeed."""

from __future__ import annotations

import argparse

from operator_app.config.any_file import AnyKind, read_any, read_files
from operator_app.config.errors import ConfigError, Problem
from operator_app.config.resources import Kind, Resource, builtin_names, expanded, resolve
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.planning.inspection import chains_of
from operator_app.report.results.check import check_text, found_json, problems_text
from operator_app.safe_output import as_json, say


def execute(args: argparse.Namespace) -> int:
    """Check the files and report on stdout."""
    missing: list[Problem] = []
    sources: list[Resource] = []
    known: dict[str, AnyKind] = {}
    for kind, name in _asked(args):
        try:
            source = _read(kind, name)
        except ConfigError as error:
            missing += error.problems
            continue
        sources.append(source)
        if kind is not None:
            known[source.file] = kind
    if not sources and not missing:
        raise UsageError("name a file, e.g. sarcal check my_arm.yaml my_hinge.yaml")
    files = read_files(sources, known, missing)
    chains = () if files.problems else chains_of(files)
    if args.json:
        say(as_json(found_json(files, chains)))
    else:
        say(problems_text(files.problems) if files.problems else check_text(files, chains))
    if files.problems:
        return ExitCode.BAD_INPUT
    refused = any(chain.refused for chain in chains)
    return ExitCode.NOT_IDENTIFIABLE if refused else ExitCode.ACCEPTED


def _asked(args: argparse.Namespace) -> list[tuple[AnyKind | None, str]]:
    """Return kind and name of every file to check; the kind is None for a file given without an option."""
    named: list[tuple[AnyKind | None, str]] = [
        ("arm", args.arm),
        ("fixture", args.fixture),
        ("procedure", args.procedure),
    ]
    return [*((None, file) for file in args.files), *(n for n in named if n[1])]


def _read(kind: AnyKind | None, name: str) -> Resource:
    """Read a file; a built-in name is refused unless an option states its kind."""
    if kind in ("arm", "fixture", "procedure"):
        return resolve(kind, name)
    kinds: tuple[Kind, ...] = ("arm", "fixture", "procedure")
    builtin = [k for k in kinds if name in builtin_names(k)]
    if builtin and not expanded(name).exists():
        options = " or ".join(f"--{k} {name}" for k in builtin)
        raise UsageError(
            f"{name} is not a file but a built-in {' and '.join(builtin)}: use {options}"
        )
    return read_any(name)
