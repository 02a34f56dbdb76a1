"""What `calibrate` makes of a shop-floor session, in figures that can be counted. Judges nothing.

The one place of these benchmarks that knows the project's results; the sessions come from
`tests.oracles.shop_floor`, which shares no code with what is judged.
"""

import time
import traceback
from dataclasses import dataclass

import numpy as np

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.result import Solution
from operator_app.config.poses_file import parse_poses
from operator_app.exit_codes import EXPECTED_ERRORS
from tests.oracles.as_shipped import ARM, HINGE
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
        return self.error / self.sigma

    @property
    def has_result(self) -> bool:
        return bool(np.all(np.isfinite(self.error)))

    @property
    def accepted(self) -> bool:
        return self.verdict in (ACCEPTED, WARNED)


def outcome(
    taken: Session, *, arm=ARM, fixture=HINGE, csv: str | None = None, **options
) -> Outcome:
    """Calibrate from a session's file, as `sarcal solve` does; options are those of `calibrate`."""
    nothing = np.full(len(PARAMETERS), np.nan)
    start = time.perf_counter()
    try:
        poses = parse_poses((taken.csv() if csv is None else csv).encode(), "poses.csv").poses
        return _read(calibrate(arm, fixture, poses, **options), taken, start)
    except EXPECTED_ERRORS as error:
        verdict, code = REFUSED, getattr(error, "code", None)
        causes = tuple(c.code for c in getattr(error, "causes", ()))
        causes = causes or (str(code or type(error).__name__),)
        said = f"{type(error).__name__}: {error}"
    except Exception:  # noqa: BLE001 - whatever it is, it is what the benchmark is to count
        verdict, causes, said = CRASHED, (), traceback.format_exc(limit=-4)
    return Outcome(
        error=nothing,
        sigma=nothing,
        verdict=verdict,
        causes=causes,
        said=said,
        seconds=time.perf_counter() - start,
    )


def _read(solution: Solution, taken: Session, start: float) -> Outcome:
    estimate = solution.estimate
    found = {
        p.name: (x, sd)
        for p, x, sd in zip(
            estimate.parameters, estimate.x, estimate.standard_deviation, strict=True
        )
    }
    value, sigma = np.array([found.get(n, (np.nan, np.nan)) for n in PARAMETERS]).T
    error = value - np.array([taken.truth[n] for n in PARAMETERS])
    angle = np.array([n.startswith(("theta_off", "alpha")) for n in PARAMETERS])
    error = np.where(angle, np.mod(error + np.pi, 2.0 * np.pi) - np.pi, error)
    said = (*solution.reasons, *(n.text for n in (*solution.warnings, *solution.causes)))
    return Outcome(
        error=error,
        sigma=sigma,
        verdict=solution.verdict.value,
        causes=tuple(c.code for c in solution.causes),
        warnings=tuple(w.code for w in solution.warnings),
        said="\n".join(said),
        seconds=time.perf_counter() - start,
    )
