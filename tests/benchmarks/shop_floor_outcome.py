"""Result of a calibration of a simulated session, as numbers and codes.

Sessions are of `tests.oracles.shop_floor`, which shares no code with the product.
"""

import traceback
from dataclasses import dataclass, field

import numpy as np

from operator_app.calibration.calibrate import calibrate
from operator_app.exit_codes import EXPECTED_ERRORS
from tests.oracles.as_shipped import ARM, HINGE, poses_of
from tests.oracles.shop_floor import PARAMETERS, Session

NORMAL_95 = 1.959963984540054
ACCEPTED, WARNED = "accepted", "accepted_with_warnings"
REFUSED, CRASHED = "not_accepted", "crashed"


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Errors and sigmas (14,) of the paper's parameters, NaN without a result; codes, the most probable cause first."""

    verdict: str
    causes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    text: str = ""
    error: np.ndarray = field(default_factory=lambda: np.full(len(PARAMETERS), np.nan))
    sigma: np.ndarray = field(default_factory=lambda: np.full(len(PARAMETERS), np.nan))

    @property
    def z(self) -> np.ndarray:
        return self.error / self.sigma

    @property
    def has_result(self) -> bool:
        return bool(np.all(np.isfinite(self.error)))

    @property
    def accepted(self) -> bool:
        return self.verdict in (ACCEPTED, WARNED)


def outcome(taken: Session, *, arm=ARM, fixture=HINGE, **options) -> Outcome:
    """Calibrate from a session's file, as `sarcal solve` does; options are those of `calibrate`."""
    try:
        solution = calibrate(arm, fixture, poses_of(taken), **options)
    except EXPECTED_ERRORS as error:
        codes = tuple(c.code for c in getattr(error, "causes", ()))
        codes = codes or (str(getattr(error, "code", None) or type(error).__name__),)
        return Outcome(verdict=REFUSED, causes=codes, text=f"{type(error).__name__}: {error}")
    except Exception:  # noqa: BLE001 - counted by the benchmark
        return Outcome(verdict=CRASHED, text=traceback.format_exc(limit=-4))
    sd = solution.estimate.sd_by_name
    values = [solution.estimate.value(n) if n in sd else np.nan for n in PARAMETERS]
    error = np.subtract(values, [taken.truth[n] for n in PARAMETERS])
    angle = [n.startswith(("theta_off", "alpha")) for n in PARAMETERS]
    texts = [n.text for n in (*solution.warnings, *solution.causes)]
    return Outcome(
        verdict=solution.verdict.value,
        causes=tuple(c.code for c in solution.causes),
        warnings=tuple(w.code for w in solution.warnings),
        text="\n".join((*solution.reasons, *texts)),
        error=np.where(angle, np.mod(error + np.pi, 2.0 * np.pi) - np.pi, error),
        sigma=np.array([sd.get(n, np.nan) for n in PARAMETERS]),
    )
