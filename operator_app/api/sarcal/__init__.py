"""Calibrate a redundant arm inside a closed chain, from Python.

>>> import sarcal
>>> made = sarcal.simulate(arm="sarcos_dextrous", fixture="hinge", poses=30, seed=0)
>>> result = sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=made.poses)
>>> result
<sarcal.Result accepted: sarcos_dextrous in hinge, 30 poses, 14 parameters>
>>> off_deg = result.values["theta_off_2_deg"] - made.truth["theta_off_2_deg"]
>>> bool(abs(off_deg) < 4 * result.sigmas["theta_off_2_deg"])
True
>>> result.fk(made.poses.q_rad).shape
(30, 4, 4)

Functions, in the order of use, and what each returns::

    load_arm, load_fixture   Arm, Fixture: from a file, or built-in by name
    load_poses, poses_of     Poses: readings of a CSV file or data frame, or of an array
    plan                     Plan: the most informative poses, before any is measured
    simulate                 Simulation: readings of a simulated arm, with its true values
    calibrate                Result: values, sigmas, intervals, verdict, fk, export; its table() returns a Table
    verify                   Verification: a Result tested with new poses
    compare                  Comparison: what drifted between two Results
    load_result              Result of an earlier session

Errors, besides TypeError and ValueError for a wrong argument::

    ConfigError, WriteError  a file is invalid, or cannot be written
    FixtureError             arm and fixture do not go together
    SolverError              the poses do not suffice for a calibration
    UnidentifiableError      a SolverError: the poses do not determine every parameter
    SessionError             a session cannot be read, or no plan can be made
    IncomparableError        a SessionError: two Results have no parameter in common

Each name has a help text: ``help(sarcal.Result)``. For a first script, type ``sarcal help scripting`` in a shell.

Your own readings may be an array (`poses_of`), a CSV file or a data frame (`load_poses`); an arm and a fixture are
files, or names of built-in files. The end of a name is its unit: ``_rad``, ``_deg``, ``_m``, ``_mm``. Angles are
sensor readings: joint angle = reading + theta_off.

**Stability.** The names in ``sarcal.__all__``, their parameters and the attributes in their docstrings are this
program's interface. They change only in a major release (before 1.0: a minor release), after a release that gave a
`DeprecationWarning`. The same holds for the keys of `Result.to_json`, which are those of ``sarcal solve --json``.
Estimates may change in their last digits: a better error model moves them within their sigmas. Everything else that can
be imported (``operator_app``, ``hardware``, ``fixtures``, ``solver``) may change with any release.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from operator_app.package_names import require_own_names

# Checked before these packages are imported: a later error would be hard to trace to its cause.
require_own_names()

if TYPE_CHECKING:
    from fixtures.errors import FixtureError
    from operator_app.calibration.comparison import IncomparableError
    from operator_app.config.errors import ConfigError, WriteError
    from operator_app.errors import SessionError
    from solver.errors import SolverError, UnidentifiableError

    from .calibrating import Comparison, Verification, calibrate, compare, load_result, verify
    from .machines import Arm, Fixture, load_arm, load_fixture
    from .planning import Plan, Simulation, plan, simulate
    from .poses import Poses, load_poses, poses_of
    from .result import Result
    from .tables import Table

_NAMES = {
    "fixtures.errors": ("FixtureError",),
    "operator_app.calibration.comparison": ("IncomparableError",),
    "operator_app.config.errors": ("ConfigError", "WriteError"),
    "operator_app.errors": ("SessionError",),
    "sarcal.calibrating": (
        "Comparison",
        "Verification",
        "calibrate",
        "compare",
        "load_result",
        "verify",
    ),
    "sarcal.machines": ("Arm", "Fixture", "load_arm", "load_fixture"),
    "sarcal.planning": ("Plan", "Simulation", "plan", "simulate"),
    "sarcal.poses": ("Poses", "load_poses", "poses_of"),
    "sarcal.result": ("Result",),
    "sarcal.tables": ("Table",),
    "solver.errors": ("SolverError", "UnidentifiableError"),
}
"""Names by module; each module is imported when one of its names is first used, so that `import sarcal` is fast."""

_HOME = {name: module for module, names in _NAMES.items() for name in names}

__all__ = [
    "Arm",
    "Comparison",
    "ConfigError",
    "Fixture",
    "FixtureError",
    "IncomparableError",
    "Plan",
    "Poses",
    "Result",
    "SessionError",
    "Simulation",
    "SolverError",
    "Table",
    "UnidentifiableError",
    "Verification",
    "WriteError",
    "calibrate",
    "compare",
    "load_arm",
    "load_fixture",
    "load_poses",
    "load_result",
    "plan",
    "poses_of",
    "simulate",
    "verify",
]


if not TYPE_CHECKING:  # else a type checker would accept any name

    def __getattr__(name: str) -> Any:
        if name not in _HOME:
            raise AttributeError(f"module 'sarcal' has no attribute {name!r}")
        value = getattr(import_module(_HOME[name]), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    # Functions only: for every class in dir(), pydoc prints all inherited members, 1,300 lines.
    functions = [name for name in __all__ if name.islower()]
    return ["__all__", "__doc__", "__file__", "__name__", "__path__", *functions]
