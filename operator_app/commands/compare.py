"""`sarcal compare`: what drifted between two calibrations of one arm."""

from __future__ import annotations

import argparse
import json
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from operator_app.commands.options import json_option, sessions_option
from operator_app.errors import SessionError
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.words_out import say

if TYPE_CHECKING:
    from operator_app.config.parameters import ParametersDocument


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    for name, words in (("a", "earlier"), ("b", "later")):
        parser.add_argument(
            name,
            metavar=name.upper(),
            help=f"{words} parameters file, session folder, session name or latest",
        )
    parser.add_argument(
        "--level",
        type=float,
        default=0.01,
        metavar="P",
        help="chance of a false alarm over all parameters together (default 0.01)",
    )
    parser.add_argument(
        "--remounted",
        action="store_true",
        help="the fixture was taken off in between: compare the arm's own parameters only",
    )
    sessions_option(parser)
    json_option(parser)


def execute(args: argparse.Namespace) -> int:
    """Compare and report on stdout."""
    from operator_app.calibration.compare import IncomparableError, compare
    from operator_app.report.comparison_result import comparison_json, comparison_text

    if not 0.0 < args.level < 1.0:
        raise UsageError(f"--level {args.level:g}: a chance lies between 0 and 1, e.g. 0.01")
    before = _load(args.a, args.sessions)
    after = _load(args.b, args.sessions)
    try:
        found = compare(before, after, level=args.level, remounted=args.remounted)
    except IncomparableError as error:
        raise UsageError(f"{args.a}, {args.b}: {error}") from error
    if args.json:
        say(json.dumps(comparison_json(found), indent=2, allow_nan=False))
    else:
        say(comparison_text(found))
    return ExitCode.NOT_ACCEPTED if found.drifted else ExitCode.ACCEPTED


def _load(reference: str, root: Path) -> ParametersDocument:
    """Read a parameters file, or the calibration in the journal of a session."""
    from operator_app.config.parameters_file import load_parameters
    from operator_app.config.resources import expanded
    from operator_app.session.export import PARAMETERS_NAME
    from operator_app.session.folder import find_session

    where = expanded(reference)
    if where.is_file():
        return load_parameters(reference)
    try:
        folder = find_session(root, reference)
    except SessionError:
        # A folder with the file alone, as somebody sent it.
        folder = where
        if not (where / PARAMETERS_NAME).is_file():
            raise
    found = _journalled(folder)
    if found is not None:
        return found
    file = folder / PARAMETERS_NAME
    if not file.is_file():
        raise UsageError(
            f"{folder}: this session has no {PARAMETERS_NAME}; write it with: sarcal export {folder}"
        )
    return load_parameters(file)


def _journalled(folder: Path) -> ParametersDocument | None:
    """Return what an export of a session's calibration would write; None where its journal has none."""
    from operator_app.composition import carried_procedure
    from operator_app.session.calibrated import Calibrated, recorded
    from operator_app.session.export import document_of
    from operator_app.session.folder import read_session
    from operator_app.session.opening import Choices, resume

    state = read_session(folder).state
    found = None if state is None else recorded(state)
    if state is None or not isinstance(found, Calibrated):
        return None
    procedure = carried_procedure(resume(str(folder), Choices(), root=folder.parent))
    solved = datetime.fromisoformat(state.solved_utc)
    return document_of(found.solution, state, procedure, utc=solved)
