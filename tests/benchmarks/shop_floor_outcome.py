"""What `calibrate` makes of a shop-floor session, in figures that can be counted. Judges nothing.

The one place of these benchmarks that knows the project's results; the sessions come from
`tests.oracles.shop_floor`, which shares no code with what is judged.
"""

import time
import traceback
from dataclasses import dataclass
from functools import cache

import numpy as np

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.result import Solution
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import parse_poses
from operator_app.exit_codes import EXPECTED_ERRORS
from tests.oracles.shop_floor import PARAMETERS, Session

NORMAL_95 = 1.959963984540054
ACCEPTED, WARNED, REFUSED, CRASHED = (
    "accepted",
    "accepted_with_warnings",
    "not_accepted",
    "crashed",
)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One calibration: errors and sigmas (14,) of the paper's parameters, and what was said.

    Both are NaN where there is no result. `causes` are codes, the most probable first; `warnings`
    are codes as well. `said` is everything in words.
    """

    error: np.ndarray
    sigma: np.ndarray
    verdict: str
    causes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    said: str = ""
    seconds: float = 0.0

    @property
    def z(self) -> np.ndarray:
        """Errors in sigmas."""
        return self.error / self.sigma

    @property
    def has_result(self) -> bool:
        return bool(np.all(np.isfinite(self.error)))

    @property
    def wrong(self) -> bool:
        """Whether any parameter is beyond four of its own sigmas."""
        return self.has_result and bool(np.any(np.abs(self.z) > 4.0))

    @property
    def accepted(self) -> bool:
        return self.verdict in (ACCEPTED, WARNED)


@cache
def packaged():
    """Arm and fixture as they are shipped."""
    return load_arm("sarcos_dextrous"), load_fixture("hinge").fixture


def outcome(
    taken: Session, *, arm=None, fixture=None, csv: str | None = None, **options
) -> Outcome:
    """Calibrate from a session's file, as `sarcal solve` does; options are those of `calibrate`."""
    own_arm, own_fixture = packaged()
    nothing = np.full(len(PARAMETERS), np.nan)
    start = time.perf_counter()
    try:
        poses = parse_poses((taken.csv() if csv is None else csv).encode(), "poses.csv").poses
        solution = calibrate(
            own_arm if arm is None else arm,
            own_fixture if fixture is None else fixture,
            poses,
            **options,
        )
    except EXPECTED_ERRORS as error:
        found = Outcome(
            error=nothing,
            sigma=nothing,
            verdict=REFUSED,
            causes=_codes(error),
            said=f"{type(error).__name__}: {error}",
            seconds=time.perf_counter() - start,
        )
    except Exception:  # noqa: BLE001 - whatever it is, it is what the benchmark is to count
        found = Outcome(
            error=nothing,
            sigma=nothing,
            verdict=CRASHED,
            said=traceback.format_exc(limit=-4),
            seconds=time.perf_counter() - start,
        )
    else:
        found = _read(solution, taken, time.perf_counter() - start)
    return found


def _read(solution: Solution, taken: Session, seconds: float) -> Outcome:
    estimate = solution.estimate
    names = [p.name for p in estimate.parameters]
    value = np.array([estimate.value(n) if n in names else np.nan for n in PARAMETERS])
    spread = estimate.standard_deviation
    sigma = np.array([spread[names.index(n)] if n in names else np.nan for n in PARAMETERS])
    error = value - np.array([taken.truth[n] for n in PARAMETERS])
    angle = np.array([n.startswith(("theta_off", "alpha")) for n in PARAMETERS])
    error = np.where(angle, np.mod(error + np.pi, 2.0 * np.pi) - np.pi, error)
    causes = getattr(solution, "causes", ())
    said = [*solution.reasons, *(w.text for w in solution.warnings), *(c.text for c in causes)]
    return Outcome(
        error=error,
        sigma=sigma,
        verdict=_verdict(solution),
        causes=tuple(c.code for c in causes),
        warnings=tuple(w.code for w in solution.warnings),
        said="\n".join(said),
        seconds=seconds,
    )


def _verdict(solution: Solution) -> str:
    verdict = getattr(solution, "verdict", None)
    if verdict is not None:
        return str(getattr(verdict, "value", verdict))
    return REFUSED if not solution.accepted else WARNED if solution.warnings else ACCEPTED


def _codes(error: Exception) -> tuple[str, ...]:
    causes = getattr(error, "causes", None)
    if causes:
        return tuple(getattr(c, "code", str(c)) for c in causes)
    code = getattr(error, "code", None)
    return (str(code),) if code else (type(error).__name__,)
