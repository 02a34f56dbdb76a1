"""`sarcal check`: lists all problems of files or, if none, states whether a calibration with them can succeed."""

from __future__ import annotations

import argparse

from operator_app.config.any_file import AnyKind, read_any, read_files
from operator_app.config.errors import ConfigError, Problem
from operator_app.config.resources import Kind, Resource, builtin_names, expanded, resolve
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.planning.inspection import chains_of
from operator_app.report.results.check import check_json, check_text, problems_text
from operator_app.safe_output import as_json, say

KINDS: tuple[Kind, ...] = ("arm", "fixture", "procedure")
"""Kinds of file that have an option and built-in files."""


def execute(args: argparse.Namespace) -> int:
    """Check the files and report on stdout."""
    missing: list[Problem] = []
    sources: list[Resource] = []
    known: dict[str, AnyKind] = {}
    named: list[tuple[AnyKind | None, str]] = [(None, file) for file in args.files]
    named += [(kind, name) for kind in KINDS if (name := getattr(args, kind))]
    for kind, name in named:
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
        say(as_json(check_json(files, chains)))
    else:
        say(problems_text(files.problems) if files.problems else check_text(files, chains))
    if files.problems:
        return ExitCode.BAD_INPUT
    refused = any(chain.refused for chain in chains)
    return ExitCode.NOT_IDENTIFIABLE if refused else ExitCode.ACCEPTED


def _read(kind: AnyKind | None, name: str) -> Resource:
    """Read a file; a built-in name is refused unless an option states its kind."""
    if kind in KINDS:
        return resolve(kind, name)
    builtin = [k for k in KINDS if name in builtin_names(k)]
    if builtin and not expanded(name).exists():
        options = " or ".join(f"--{k} {name}" for k in builtin)
        raise UsageError(
            f"{name} is not a file but a built-in {' and '.join(builtin)}: use {options}"
        )
    return read_any(name)
