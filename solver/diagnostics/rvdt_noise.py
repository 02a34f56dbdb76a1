"""Noise of one single RVDT reading, from the spread inside the poses or from how the loops scatter.

Knows one sensor's readings and its variance component; no loop, no curve and no verdict.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.sensors import DITHER, Rvdt
from solver.estimators.component_report import Component

TERMS = 200
"""Terms of the rounding series; what is left out is below 1e-3 LSB^2 where there is no noise at all."""

TOLD = 4.0
"""A 95 % interval whose ends are further apart than this factor is no figure, only a bound."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SingleNoise:
    """Noise of a single reading, without what rounding to whole LSB adds.

    Attributes
    ----------
    lsb, low, high
        Value and 95 % interval, LSB.
    from_spread
        Whether the spread inside the poses told it; otherwise the scatter of the loops did.
    """

    lsb: float
    low: float
    high: float
    from_spread: bool

    @property
    def told(self) -> bool:
        """Whether there is a figure; otherwise only `high` is known."""
        return self.low > 0.0 and self.high <= TOLD * self.low


def single_noise(
    sensor: Rvdt, component: Component | None, sd_rad: FloatArray | None, samples: IntArray
) -> SingleNoise | None:
    """Return the noise of a single reading; None where neither spread nor component tells of it.

    Parameters
    ----------
    component
        What the closed loops say of single readings; None for a joint whose readings are not used.
    sd_rad
        Spread of the single readings of each pose (m,), where recorded.
    samples
        Readings in each pose's mean (m,).
    """
    if sd_rad is not None and np.any(sd_rad[samples > 1]):
        return _of_spread(sd_rad / sensor.resolution_rad, samples)
    if component is None:
        return None
    # Rounding is part of the component where the stated noise dithers it, and only there.
    rounding = 1.0 / 12.0 if sensor.noise_lsb >= DITHER else 0.0
    sizes = np.array([component.sd, component.low, component.high]) / sensor.resolution_rad
    lsb, low, high = np.sqrt(np.maximum(sizes**2 - rounding, 0.0)).tolist()
    return SingleNoise(lsb=lsb, low=low, high=high, from_spread=False)


def _of_spread(sd_lsb: FloatArray, samples: IntArray) -> SingleNoise:
    """Pool the spreads (m,) of poses of `samples` readings each."""
    from scipy.special import chdtri

    weight = (samples - 1) / (samples - 1).sum()
    pooled = float(weight @ sd_lsb**2)
    # Below half an LSB some poses flicker and others stand still: the poses themselves say how much.
    between = float(weight**2 @ (sd_lsb**2 - pooled) ** 2)
    dof = float((samples - 1).sum())
    if between > 0.0:
        dof = min(dof, 2.0 * pooled**2 / between)
    low, high = (pooled * dof / chdtri(dof, (0.025, 0.975))).tolist()
    return SingleNoise(
        lsb=noise_behind(pooled),
        low=noise_behind(low),
        high=noise_behind(high),
        from_spread=True,
    )


def spread_of(noise_lsb: float) -> float:
    """Mean square spread (LSB^2) of rounded readings of a joint that may stand anywhere.

    Half the mean square difference of two readings. Rounded, a difference d becomes one of its two
    neighbours with the mean square ``d^2 + f (1 - f)``, f the fraction of d; as a Fourier series, and
    over d of variance ``2 noise^2``:

        S = noise^2 + 1/12 - sum_k exp(-4 pi^2 k^2 noise^2) / (2 pi^2 k^2)

    which is 1/12 more than the noise's where that is large, and 0 where there is none.
    """
    k = np.arange(1, TERMS + 1)
    less = np.exp(-((2.0 * np.pi * k * noise_lsb) ** 2)) / (2.0 * np.pi**2 * k**2)
    return float(noise_lsb**2 + 1.0 / 12.0 - less.sum())


def noise_behind(mean_square: float) -> float:
    """Noise (LSB) whose rounded readings have this mean square spread (LSB^2), which `spread_of` inverts."""
    if mean_square > 1.0 + 1.0 / 12.0:
        # From 1 LSB on the series is nothing: exp(-4 pi^2).
        return float(np.sqrt(mean_square - 1.0 / 12.0))
    least, most = 0.0, float(np.sqrt(mean_square)) + 1.0
    if mean_square <= spread_of(least):
        return 0.0
    for _ in range(50):
        middle = 0.5 * (least + most)
        least, most = (middle, most) if spread_of(middle) < mean_square else (least, middle)
    return 0.5 * (least + most)
