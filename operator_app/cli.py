# PYTHON_ARGCOMPLETE_OK
"""The command line: parsing, dispatch, error messages and exit codes.

Commands are imported when they are called, so that ``--help`` and the terminal app start fast.
"""

import argparse
import difflib
import errno
import os
import re
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

from operator_app.commands.table import APP, COMMANDS, complete, declare, module, words_to_complete
from operator_app.package_names import ForeignPackageError, require_own_names
from operator_app.safe_output import open_closed_streams, sanitized, say, silence
from operator_app.signals import INTERRUPTED, ProcessEnd, ending_signals_interrupt, interrupted

NUMBERS = re.compile(r"-[\d.][\d.eE+-]*(,[\d.eE+-]+)*")
"""Pattern of option values that begin with a minus sign, such as ``-60,0,80``."""

DESCRIPTION = """\
Calibrate a redundant arm without an external measuring device: the tool is bolted to the table
through a passive hinge, the arm moves inside the closed chain, and its joint readings alone give
the joint-angle offsets and where the hinge is. Without a command, the terminal app opens: on the
embedded virtual arm, or on a bus named with -i, -c and -b."""

EPILOG = """\
Names such as `hinge` are built-in files; a path works everywhere a name does. Results go to stdout,
progress to stderr.

exit codes: 0 accepted; 2 usage or bad input; 3 bus or arm fault; 4 solved but not accepted;
5 not identifiable; 130 interrupted."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code."""
    # The matrices are small: more threads would only compete with the bus.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    open_closed_streams()
    process = argv is None  # False: called from Python code
    end = ProcessEnd() if process else None
    code = 1
    try:
        with ending_signals_interrupt(for_good=process):
            code = _code(sys.argv[1:] if argv is None else list(argv))
    except SystemExit as error:  # raised by argparse
        code = error.code if isinstance(error.code, int) else 0
        raise
    except BaseException as error:
        # An interrupted import may raise anything.
        if not (isinstance(error, KeyboardInterrupt) or (interrupted() and process)):
            raise
        for text in ("interrupted.", *getattr(error, "__notes__", ())):
            say(f"sarcal: {text}", err=True)
        code = INTERRUPTED
    finally:
        if end is not None:
            end.soon(code)
    return code


def _code(argv: list[str]) -> int:
    try:
        require_own_names()
    except ForeignPackageError as error:
        say(f"sarcal: {error}.", err=True)
        return 2
    try:
        return _dispatch(argv)
    except BrokenPipeError:
        silence(sys.stdout)
        return 0
    except OSError as error:
        if error.filename is not None or error.errno != errno.ENOSPC:
            raise
        silence(sys.stdout)
        say("sarcal: the results cannot be written: no space left. Free some.", err=True)
        return 2


def _dispatch(argv: Sequence[str]) -> int:
    parser = _Parser(
        prog="sarcal",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    completing = words_to_complete()
    arguments = argv if completing is None else completing
    command = next((word for word in arguments if word in COMMANDS), APP)
    if command == APP:
        declare(APP, parser)
    chosen = None
    subparsers = parser.add_subparsers(
        dest="command", metavar="COMMAND", title="commands", parser_class=_CommandParser
    )
    for name, summary in COMMANDS.items():
        sub = subparsers.add_parser(
            name, help=summary, description=summary[0].upper() + summary[1:] + "."
        )
        if name == command:
            declare(name, sub)
            chosen = sub
    if completing is not None:
        complete(parser, chosen)
    args = parser.parse_args(argv)

    from operator_app.config.errors import ConfigError
    from operator_app.exit_codes import EXPECTED_ERRORS, exit_code

    command = module(args.command or APP)
    try:
        code = int(command.execute(args))
    except EXPECTED_ERRORS as error:
        # A ConfigError has one line for each problem.
        text = f"sarcal: {error}"
        say(text if isinstance(error, ConfigError) else sanitized(text), err=True)
        return int(exit_code(error))
    # Flush here, so that a full disk is reported.
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        silence(sys.stdout)
    return code


ALSO_CALLED = {
    "calibrate": "solve (from a file of poses) or run (with an arm)",
    "list": "session list",
    "upload": "export SESSION --upload",
    "manual": "help",
}


class _Parser(argparse.ArgumentParser):
    """Parser that suggests a command if the typed one is unknown, and prints errors without control characters."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        # Otherwise argparse mistakes lists of numbers that begin with a minus sign for options.
        self._negative_number_matcher = NUMBERS

    def error(self, message: str) -> NoReturn:
        if unknown := re.match(r"argument COMMAND: invalid choice: '(.*?)'", message):
            meant = ALSO_CALLED.get(unknown[1])
            near = [meant] if meant else difflib.get_close_matches(unknown[1], COMMANDS, n=1)
            hint = f"did you mean {near[0]}? " if near else ""
            message = f"there is no command {unknown[1]!r}; {hint}all: {', '.join(COMMANDS)}"
        super().error(sanitized(message))

    def print_help(self, file: object = None) -> None:
        """Print the help on stdout; unlike argparse's method, raise `OSError` if stdout cannot be written."""
        say(self.format_help().removesuffix("\n"))


class _CommandParser(_Parser):
    """Parser of a command; it accepts arguments and options in any order.

    Up to Python 3.12, argparse loses an optional positional argument after an option (`session show --json latest`).
    """

    _underway = False

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        if self._underway or "--" in (args or ()):
            return super().parse_known_args(args, namespace)
        self._underway = True
        try:
            parsed, unknown = self.parse_known_intermixed_args(args, namespace)
        finally:
            self._underway = False
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return parsed, unknown


class _Version(argparse.Action):
    """Action of ``--version``, which imports `importlib.metadata` only when called, because that import is slow."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any, **__: Any) -> None:
        from importlib.metadata import version

        say(f"sarcal {version('sarcal')}")
        parser.exit()


if __name__ == "__main__":
    sys.exit(main())
