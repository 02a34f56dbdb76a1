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

Own readings come as an array (`poses_of`), a CSV file or a data frame (`load_poses`); an arm and a fixture
are files, or the names of packaged ones. What a name ends in is its unit: ``_rad``, ``_deg``, ``_m``,
``_mm``. Angles are what the sensors read: joint angle = reading + theta_off.

**What stays as it is.** The names in ``sarcal.__all__``, their parameters and the attributes that their
docstrings list are this program's interface, and are changed only by a release that raises the version's
first number (before 1.0: the second), after one that warned (`DeprecationWarning`). The keys of
`Result.to_json` are those of ``sarcal solve --json``, under the same promise. Estimates are not promised to
the last digit: a better error model moves them within their sigmas. Everything else that can be imported
(``operator_app``, ``hardware``, ``fixtures``, ``solver``) may change with any release.
"""

from operator_app.package_names import require_own_names

# Before anything is imported by these names: what fails later fails far from the cause.
require_own_names()

from fixtures.errors import FixtureError  # noqa: E402
from operator_app.calibration.comparison import IncomparableError  # noqa: E402
from operator_app.config.errors import ConfigError, WriteError  # noqa: E402
from operator_app.errors import SessionError  # noqa: E402
from solver.errors import SolverError, UnidentifiableError  # noqa: E402

from .calibrating import calibrate  # noqa: E402
from .judging import Comparison, Verification, compare, verify  # noqa: E402
from .loading import load_result  # noqa: E402
from .machines import Arm, Fixture, load_arm, load_fixture  # noqa: E402
from .planning import Plan, Simulation, plan, simulate  # noqa: E402
from .poses import Poses, load_poses, poses_of  # noqa: E402
from .result import Result  # noqa: E402
from .tables import Table  # noqa: E402

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
