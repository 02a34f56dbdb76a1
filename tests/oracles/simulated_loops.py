"""Simulated readings with every error source of the paper. Shares no code with `solver`."""

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from tests.oracles.loop_oracle import Truth, closed_poses, paper_truth

COUNT_RAD = 2.0 * np.pi / 400_000
ENCODER_SD = COUNT_RAD / np.sqrt(12.0)
FULL_SCALE_RAD = np.deg2rad(120.0)
LSB_RAD = FULL_SCALE_RAD / 4096
RVDT_SD = LSB_RAD * np.sqrt(2.0**2 + 1.0 / 12.0)


@dataclass(frozen=True)
class RvdtCurve:
    """Smooth RVDT deviation (rad): amplitudes (fractions of full scale) of Legendre P2..P5."""

    amplitudes: tuple[float, ...]
    middle_rad: float

    def __call__(self, theta: np.ndarray) -> np.ndarray:
        x = (theta - self.middle_rad) / (0.5 * FULL_SCALE_RAD)
        series = np.zeros(len(self.amplitudes) + 2)
        series[2:] = np.array(self.amplitudes) * FULL_SCALE_RAD
        return np.polynomial.legendre.legval(x, series)


@dataclass(frozen=True)
class Simulation:
    poses: int = 60
    wrist_sd: float = RVDT_SD
    encoder_sd: float = ENCODER_SD
    flexure_m: float = 0.0
    flexure_rad: float = 0.0
    bows: dict[int, RvdtCurve] = field(default_factory=dict)
    gains: dict[int, float] = field(default_factory=dict)
    truth: Truth = field(default_factory=paper_truth)
    spread_deg: float = 45.0

    def sigma(self) -> np.ndarray:
        return np.array([self.encoder_sd] * 5 + [self.wrist_sd] * 2)

    def readings(self, seed: int) -> np.ndarray:
        """Readings (m, 7) of random closed poses."""
        rng = np.random.default_rng(seed)
        return self.read(self.closed(rng), rng)

    def rereadings(self, seed: int) -> np.ndarray:
        """Readings (m, 7) of a constant set of closed poses, with independent noise."""
        if self.flexure_m > 0.0 or self.flexure_rad > 0.0:
            raise ValueError("a compliant fixture moves the poses: use readings()")
        closed = _same_poses(self.poses, self.spread_deg)
        return self.read(closed, np.random.default_rng([seed, 1]))

    def closed(self, rng: np.random.Generator) -> np.ndarray:
        """True angles (m, 8) of loops that close against the fixture's deflection."""
        give = None
        if self.flexure_m > 0.0 or self.flexure_rad > 0.0:
            size = np.array([self.flexure_rad] * 3 + [self.flexure_m] * 3)
            give = rng.normal(size=(self.poses, 6)) * size
        return closed_poses(self.truth, rng, self.poses, give=give, spread_deg=self.spread_deg)

    def read(self, closed: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Noisy readings (m, 7) of true angles (m, 8)."""
        angles = closed[:, 1:]
        readings = angles + rng.normal(size=angles.shape) * self.sigma()
        for joint, bow in self.bows.items():
            readings[:, joint - 1] += bow(angles[:, joint - 1])
        for joint, gain in self.gains.items():
            readings[:, joint - 1] += gain * (angles[:, joint - 1] - self.truth.home[joint - 1])
        return readings


@lru_cache
def _same_poses(poses: int, spread_deg: float) -> np.ndarray:
    """Closed poses of the paper's loop, cached: they take longer than a fit."""
    return closed_poses(paper_truth(), np.random.default_rng(99), poses, spread_deg=spread_deg)


def wrist_curves(percent: float = 1.0) -> dict[int, RvdtCurve]:
    """Bows of about `percent` of full scale at their peak, on joints 6 and 7."""
    home = paper_truth().home
    return {
        6: RvdtCurve((0.006 * percent, 0.007 * percent), float(home[5])),
        7: RvdtCurve((-0.008 * percent, 0.003 * percent), float(home[6])),
    }
