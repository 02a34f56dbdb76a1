"""`sarcal session list|show`: what sessions there are and what is in one."""

from __future__ import annotations

import argparse
import json
from typing import Any

from operator_app.commands.options import json_option, sessions_option
from operator_app.exit_codes import ExitCode


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("action", choices=("list", "show"), help="list all, or show one")
    parser.add_argument("name", nargs="?", default="latest", help="folder, name or latest")
    sessions_option(parser)
    json_option(parser)


def execute(args: argparse.Namespace) -> int:
    """Report on stdout."""
    from operator_app.errors import JournalError
    from operator_app.report.text import aligned
    from operator_app.session.folder import (
        SessionEntry,
        find_session,
        list_sessions,
        read_session,
    )

    def facts(entry: SessionEntry) -> dict[str, Any]:
        state = entry.state
        if state is None:
            return {"folder": str(entry.folder), "problem": entry.problem}
        return {
            "folder": str(entry.folder),
            "opened_utc": state.opened_utc,
            "serial_number": state.serial_number,
            "modes": list(state.modes),
            "poses": len(state.used_poses),
            "excluded": [p.number for p in state.poses if p.excluded],
            "solved": dict(state.solved),
            "exported": dict(state.exported),
            "torn": entry.torn,
        }

    if args.action == "list":
        found = [facts(entry) for entry in list_sessions(args.sessions)]
        if args.json:
            print(json.dumps(found, indent=2))
        elif not found:
            print(f"No sessions in {args.sessions}. `sarcal run hinge` makes one.")
        else:
            rows = [["session", "begun (UTC)", "arm", "poses", "state"]]
            for fact in found:
                if "problem" in fact:
                    rows.append([fact["folder"], "", "", "", fact["problem"]])
                    continue
                stage = "captured"
                if fact["solved"]:
                    stage = "accepted" if fact["solved"]["accepted"] else "not accepted"
                if fact["exported"]:
                    stage = "exported"
                rows.append(
                    [
                        fact["folder"],
                        fact["opened_utc"][:19].replace("T", " "),
                        fact["serial_number"] or "-",
                        str(fact["poses"]),
                        stage,
                    ]
                )
            print(aligned(rows))
        return ExitCode.ACCEPTED
    entry = read_session(find_session(args.sessions, args.name))
    if entry.problem:
        raise JournalError(entry.problem, "restore the journal from a copy")
    fact = facts(entry)
    if args.json:
        print(json.dumps(fact, indent=2))
    else:
        for key, value in fact.items():
            print(f"{key.replace('_', ' ')}: {value if value not in ('', [], {}) else '-'}")
    return ExitCode.ACCEPTED
