"""Exit codes of `sarcal`, which never change because scripts use them, and the exit code of each error."""

from collections.abc import Mapping
from enum import IntEnum

from fixtures.errors import FixtureError
from hardware.errors import BusSettingsError, HardwareError
from operator_app.config.errors import ConfigError, WriteError
from operator_app.errors import DrivesNotOffError, SessionError
from solver.errors import SolverError, UnidentifiableError


class ExitCode(IntEnum):
    """Exit code of a command."""

    ACCEPTED = 0
    BAD_INPUT = 2
    ARM_FAULT = 3
    NOT_ACCEPTED = 4
    NOT_IDENTIFIABLE = 5
    INTERRUPTED = 130


MEANING: Mapping[ExitCode, str] = {
    ExitCode.ACCEPTED: "done; a calibration: accepted, with or without warnings",
    ExitCode.BAD_INPUT: "usage or bad input",
    ExitCode.ARM_FAULT: "bus or arm fault, or the arm did not confirm at its release that it holds",
    ExitCode.NOT_ACCEPTED: "solved but not accepted; a verification that failed, or a comparison that shows drift",
    ExitCode.NOT_IDENTIFIABLE: "not identifiable: the poses do not determine every parameter",
    ExitCode.INTERRUPTED: "interrupted; the arm is held, the session is kept",
}
"""Meaning of each exit code, as text for the manual."""


class UsageError(Exception):
    """Invalid or contradictory options; the text names them and says what to do."""


EXPECTED_ERRORS = (
    ConfigError,
    WriteError,
    UsageError,
    SessionError,
    HardwareError,
    FixtureError,
    SolverError,
)
"""Errors that a user can cause. Any other exception is a program error and shows its traceback."""


def exit_code(error: BaseException) -> ExitCode:
    """Return the exit code for an error of `EXPECTED_ERRORS`."""
    match error:
        case BusSettingsError():
            return ExitCode.BAD_INPUT
        case HardwareError() | DrivesNotOffError():
            return ExitCode.ARM_FAULT
        case UnidentifiableError() | FixtureError():
            return ExitCode.NOT_IDENTIFIABLE
        case _:
            return ExitCode.BAD_INPUT
