"""`sarcal session list|show|repair`: lists sessions, shows one, repairs a damaged journal."""

import argparse
from typing import Any

from operator_app.errors import JournalError
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.report.results.session import (
    repair_json,
    repair_text,
    session_table_text,
    solved_json,
)
from operator_app.report.text import aligned
from operator_app.safe_output import as_json, say
from operator_app.session.store import folders
from operator_app.session.store.journal_repair import repair_journal


def execute(args: argparse.Namespace) -> int:
    """List, show or repair sessions, and print the result."""
    if args.action == "list":
        if args.name is not None:
            raise UsageError(
                f"session list: takes no name; show one with: sarcal session show {args.name}"
            )
        sessions = folders.list_sessions(args.sessions)
        if args.json:
            say(as_json([_facts(entry) for entry in sessions]))
        elif not sessions:
            say(f"No sessions in {args.sessions}. `sarcal run hinge` makes one.")
        else:
            say(
                aligned([["session", "begun (UTC)", "arm", "poses", "state"], *map(_row, sessions)])
            )
        return ExitCode.ACCEPTED
    if args.action == "repair":
        if args.name is None:
            raise UsageError("session repair: name the session; `sarcal session list` shows them")
        repair = repair_journal(folders.find_session(args.sessions, args.name))
        say(as_json(repair_json(repair)) if args.json else repair_text(repair))
        return ExitCode.ACCEPTED
    entry = folders.read_session(folders.find_session(args.sessions, args.name or "latest"))
    if entry.problem:
        raise JournalError(entry.problem, entry.remedy)
    if args.json:
        say(as_json(_facts(entry)))
    elif entry.state is not None:
        title = ": ".join(filter(None, folders.documents_of(entry.state)))
        say(session_table_text(entry.folder, entry.state, procedure=title, torn=entry.torn))
    return ExitCode.ACCEPTED


def _facts(entry: folders.SessionEntry) -> dict[str, Any]:
    state = entry.state
    if state is None:
        return {"folder": str(entry.folder), "problem": entry.problem}
    return {
        "folder": str(entry.folder),
        "opened_utc": state.opened_utc,
        "serial_number": state.serial_number,
        "modes": [mode.value for mode in state.modes],
        "poses": len(state.used_poses),
        "excluded": [p.number for p in state.poses if p.excluded],
        "solved": solved_json(state),
        "exported": dict(state.exported),
        "torn": entry.torn,
    }


def _row(entry: folders.SessionEntry) -> list[str]:
    folder, state = str(entry.folder), entry.state
    if state is None:
        # The folder is in the first column already.
        return [folder, "", "", "", entry.problem.replace(f"{folder}/", "")]
    stage = "captured" if state.used_poses else "begun"
    if state.solved:
        stage = "accepted" if state.solved["accepted"] else "not accepted"
    if state.exported:
        stage = "exported"
    begun = state.opened_utc[:19].replace("T", " ")
    return [folder, begun, state.serial_number or "-", str(len(state.used_poses)), stage]
