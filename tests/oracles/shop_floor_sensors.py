"""Simulated joint sensors: means and standard deviations of samples at true angles.

Encoders: errors once and twice per turn, counts. RVDTs: a smooth linearity deviation, a gain, noise, and a
converter that saturates.
"""

from dataclasses import dataclass

import numpy as np

CURVES = ("bow and S", "sine", "ratio", "bump", "kink")


@dataclass(frozen=True, kw_only=True)
class Encoder:
    """`once` and `twice` are cosine and sine (rad) of the error per turn."""

    counts_per_rev: int
    once: tuple[float, float] = (0.0, 0.0)
    twice: tuple[float, float] = (0.0, 0.0)

    def deviation(self, angle: np.ndarray) -> np.ndarray:
        harmonics = enumerate((self.once, self.twice), 1)
        return sum(c * np.cos(k * angle) + s * np.sin(k * angle) for k, (c, s) in harmonics)

    def read(self, angle: np.ndarray, samples: int, rng: np.random.Generator):
        """Means and standard deviations of `samples` readings of joints that stand still."""
        count = 2.0 * np.pi / self.counts_per_rev
        mean = np.round((angle + self.deviation(angle)) / count) * count
        return mean, np.zeros_like(mean)


@dataclass(frozen=True, kw_only=True)
class Rvdt:
    """`shape` (k,) are deviations (rad) from the best-fit line, at even steps over full scale."""

    bits: int
    full_scale: float
    zero: float
    noise_lsb: float
    shape: np.ndarray
    gain: float = 0.0

    def deviation(self, angle: np.ndarray) -> np.ndarray:
        x = np.clip((angle - self.zero) / (0.5 * self.full_scale), -1.0, 1.0)
        places = np.linspace(-1.0, 1.0, len(self.shape))
        return np.interp(x, places, self.shape) + self.gain * (angle - self.zero)

    def read(self, angle: np.ndarray, samples: int, rng: np.random.Generator):
        """Means and standard deviations of `samples` readings of joints that stand still."""
        lsb = self.full_scale / 2**self.bits
        true = (angle - self.zero + self.deviation(angle)) / lsb
        noise = self.noise_lsb * rng.normal(size=(samples, *angle.shape))
        half = 2 ** (self.bits - 1)
        counts = np.clip(np.round(true + noise), -half, half - 1)
        spread = counts.std(axis=0, ddof=1) if samples > 1 else np.zeros_like(angle)
        return self.zero + lsb * counts.mean(axis=0), lsb * spread


def drawn_curve(kind: str, rng: np.random.Generator) -> np.ndarray:
    """Deviation from the best-fit line over full scale, with a peak of one."""
    x = np.linspace(-1.0, 1.0, 2001)
    if kind == "bow and S":
        sizes = rng.normal(size=4) * (1.0, 1.0, 0.4, 0.2)
        y = np.polynomial.legendre.legval(x, (0.0, 0.0, *sizes))
    elif kind == "sine":
        y = np.sin(np.pi * rng.uniform(0.6, 1.4) * x + rng.uniform(0.0, 2.0 * np.pi))
    elif kind == "ratio":
        # Unbalanced primary and secondaries: the ratio is x / (1 + b x + c x^2).
        b, c = rng.uniform(-0.5, 0.5), rng.uniform(0.1, 0.5)
        y = rng.choice((-1.0, 1.0)) * x / (1.0 + b * x + c * x**2)
    elif kind == "bump":
        y = rng.choice((-1.0, 1.0)) * np.exp(
            -0.5 * ((x - rng.uniform(-0.7, 0.7)) / rng.uniform(0.3, 0.6)) ** 2
        )
    else:
        bend = rng.uniform(-0.5, 0.5)
        y = rng.choice((-1.0, 1.0)) * np.sqrt((x - bend) ** 2 + 0.2**2)
    y = y - np.polynomial.polynomial.polyval(x, np.polynomial.polynomial.polyfit(x, y, 1))
    return y / np.abs(y).max()
