"""`sarcal settings`: shows or changes the user settings."""

from __future__ import annotations

import argparse

from operator_app.commands.options import option, options
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.safe_output import as_json, say

SETTINGS_MEANING = {
    "interface": "the bus, as -i",
    "channel": "as -c, with that interface",
    "bitrate": "as -b, with that interface",
    "theme": "of the terminal app: dark, light, none",
    "operator": "recorded in the journal of every session",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    option(
        parser,
        "settings* KEY=VALUE",
        "set it; KEY= removes it. Keys: " + ", ".join(SETTINGS_MEANING),
    )
    options(parser, "--json")


def execute(args: argparse.Namespace) -> int:
    """Change the named settings, then show all."""
    from operator_app.config.user_settings import (
        KEYS,
        changed,
        load_settings,
        save_settings,
        settings_path,
    )

    words: dict[str, str] = {}
    for text in args.settings:
        key, equals, value = text.partition("=")
        if not equals:
            raise UsageError(f"{text!r}: write KEY=VALUE, with KEY one of {', '.join(KEYS)}")
        words[key] = value.strip()
    path = settings_path()
    if words:
        found = changed(words)
        try:
            path = save_settings(found)
        except OSError as error:
            raise UsageError(f"{path} cannot be written: {error.strerror}") from error
    else:
        found = load_settings()
    if args.json:
        say(as_json({"file": str(path), "settings": found.stated}))
        return ExitCode.ACCEPTED
    say(f"File       {path}{'' if path.exists() else ' (there is none)'}")
    for key, meaning in SETTINGS_MEANING.items():
        say(f"{key:<10} {found.stated.get(key, '-')!s:<20} {meaning}")
    say(
        "Precedence: command line, session, procedure, environment (CAN_INTERFACE), can.conf, these settings.\n"
        "`virtual` in a procedure names no bus; -i virtual does, and is the simulated arm."
    )
    return ExitCode.ACCEPTED
