"""`sarcal settings`: shows or changes the user settings."""

import argparse

from operator_app.commands.file_arguments import SETTINGS_MEANING
from operator_app.config import user_settings
from operator_app.config.resources import exists
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.safe_output import as_json, say


def execute(args: argparse.Namespace) -> int:
    """Change the settings that the arguments state, then show all settings."""
    texts: dict[str, str] = {}
    for text in args.settings:
        key, equals, value = text.partition("=")
        if not equals:
            raise UsageError(
                f"{text!r}: write KEY=VALUE, with KEY one of {', '.join(user_settings.KEYS)}"
            )
        texts[key] = value.strip()
    path = user_settings.settings_path()
    if texts:
        settings = user_settings.changed(texts)
        try:
            path = user_settings.save_settings(settings)
        except OSError as error:
            raise UsageError(f"{path} cannot be written: {error.strerror}") from error
    else:
        settings = user_settings.load_settings()
    if args.json:
        say(as_json({"file": str(path), "settings": settings.stated}))
        return ExitCode.ACCEPTED
    say(f"File       {path}{'' if exists(path) else ' (there is none)'}")
    for key, meaning in SETTINGS_MEANING.items():
        say(f"{key:<10} {settings.stated.get(key, '-')!s:<20} {meaning}")
    say(
        "Precedence: command line, session, procedure, environment (CAN_INTERFACE), can.conf, these settings.\n"
        "`virtual` in a procedure selects no bus; -i virtual selects the simulated arm."
    )
    return ExitCode.ACCEPTED
