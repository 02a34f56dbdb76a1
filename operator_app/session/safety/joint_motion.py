"""Speed and standstill of the joints from snapshots of the arm, for display.

Captures use the settling of the arm itself, SYNC by SYNC.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from hardware.arm import ArmSnapshot
from operator_app.config.procedure import CapturePlan
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel

SPEED_WINDOW_S = 0.5
RATE_WINDOW_S = 1.0
MIN_SAMPLES = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Motion of the joints over the last half second.

    Attributes
    ----------
    sync_rate_hz
        SYNC messages a second.
    speed_rad_per_s
        (n,) slopes of lines fitted to the measured angles.
    still
        Whether the spread of every joint is within the settle rule.
    held_s, needed_s
        Time at standstill, and the time that settling and measuring a pose take.
    worst_joint, spread_share
        Joint (1-based) with the largest spread relative to its limit, and that ratio.
    """

    sync_rate_hz: float
    speed_rad_per_s: FloatArray
    still: bool
    held_s: float
    needed_s: float
    worst_joint: int
    spread_share: float


class MotionMonitor:
    """Computes `Motion` from snapshots, in one thread; `capture` has the settle rule."""

    def __init__(self, arm: ArmModel, capture: CapturePlan) -> None:
        self._allowed = np.array(capture.settle.spread_rad(arm))
        self._window = capture.settle.window_syncs
        self._needed = self._window + capture.samples_per_pose
        self._samples: deque[tuple[float, int, FloatArray]] = deque()
        self._still_since_s: float | None = None

    def reset(self) -> None:
        """Start again, after a gap in the data."""
        self._samples.clear()
        self._still_since_s = None

    def update(self, now_s: float, arm: ArmSnapshot) -> Motion:
        """Add a snapshot and return the motion."""
        samples = self._samples
        samples.append((now_s, arm.sync_count, arm.positions_rad))
        while now_s - samples[0][0] > RATE_WINDOW_S:
            samples.popleft()
        elapsed = now_s - samples[0][0]
        rate = (arm.sync_count - samples[0][1]) / elapsed if elapsed > 0.0 else 0.0
        # At least four samples: with a fast SYNC the settle window may hold only one, which has no spread.
        late = [q for _, sync, q in samples if arm.sync_count - sync < self._window]
        recent = np.array(
            late if len(late) >= MIN_SAMPLES else [q for _, _, q in samples][-MIN_SAMPLES:]
        )
        share = np.ptp(recent, axis=0) / self._allowed
        worst = int(np.argmax(share))
        still = bool(share[worst] <= 1.0)
        if not still:
            self._still_since_s = None
        elif self._still_since_s is None:
            self._still_since_s = now_s
        return Motion(
            sync_rate_hz=rate,
            speed_rad_per_s=self._speeds(now_s),
            still=still,
            held_s=0.0 if self._still_since_s is None else now_s - self._still_since_s,
            needed_s=self._needed / rate if rate > 0.0 else 0.0,
            worst_joint=worst + 1,
            spread_share=float(share[worst]),
        )

    def _speeds(self, now_s: float) -> FloatArray:
        late = [(t, q) for t, _, q in self._samples if now_s - t <= SPEED_WINDOW_S]
        t = np.array([t for t, _ in late])
        q = np.array([q for _, q in late])
        t = t - t.mean()
        square = float(t @ t)
        return t @ (q - q.mean(axis=0)) / square if square > 0.0 else np.zeros(q.shape[1])
