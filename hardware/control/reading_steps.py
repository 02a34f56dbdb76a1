"""Settling and readings as steps (`hardware.control.tasks.Steps`); they send no commands."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Sequence

import numpy as np

from hardware.arm import Reading
from hardware.canopen.cyclic import Sample, Setpoints
from hardware.control.steps import LoopView, incomplete_samples, raise_alarm
from hardware.scale import JointScale

SYNCS_PER_SAMPLE, EXTRA_SYNCS = 20, 100
"""Limit of a reading in SYNCs: per sample, and in addition; frames may be lost."""


def settle(
    loop: LoopView,
    scales: Sequence[JointScale],
    *,
    window: int,
    spread_rad: Sequence[float],
    timeout_syncs: int,
) -> Generator[Setpoints | None, Sample, bool]:
    """Wait until every joint's spread over the last `window` complete samples is within `spread_rad`."""
    bounds = np.array([s * scale.density for s, scale in zip(spread_rad, scales, strict=True)])
    recent: deque[tuple[int, ...]] = deque(maxlen=window)
    for _ in range(timeout_syncs):
        sample = yield None
        raise_alarm(loop)
        if sample.complete:
            recent.append(sample.counts)
            if len(recent) == window and np.all(np.ptp(np.array(recent), axis=0) <= bounds):
                return True
    return False


def capture(
    loop: LoopView, scales: Sequence[JointScale], *, samples: int
) -> Generator[Setpoints | None, Sample, Reading]:
    """Average complete samples, each with all joints latched on the same SYNC."""
    rows: list[tuple[int, ...]] = []
    first = 0
    for _ in range(EXTRA_SYNCS + SYNCS_PER_SAMPLE * samples):
        if len(rows) == samples:
            break
        sample = yield None
        raise_alarm(loop)
        if sample.complete:
            first = first or sample.sync_count
            rows.append(sample.counts)
    if len(rows) < samples:
        raise incomplete_samples(sample)
    counts = np.array(rows, dtype=np.float64)
    mean = counts.mean(axis=0)
    spread = counts.std(axis=0, ddof=1) if samples > 1 else np.zeros(len(scales))
    return Reading(
        mean_counts=mean,
        mean_rad=np.array([s.to_rad(m) for s, m in zip(scales, mean.tolist(), strict=True)]),
        sd_rad=spread / [scale.density for scale in scales],
        samples=samples,
        first_sync=first,
    )
