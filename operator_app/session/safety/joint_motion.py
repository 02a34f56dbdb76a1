"""How the joints have moved lately, from looks at the arm a few times a second. Knows no bus and no screen.

What decides over a capture is the arm's own settling, SYNC by SYNC; this is what a person sees of it.
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
FEWEST = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """The joints over the last half second.

    Attributes
    ----------
    sync_rate_hz
        SYNC messages a second.
    speed_rad_per_s
        (n,) slopes of straight lines through the measured angles: sensor noise averages out.
    still
        Whether every joint spreads less than the settle rule allows.
    held_s, needed_s
        For how long that has been so; how long settling and reading a pose take.
    worst_joint, spread_share
        Joint (1-based) that spreads most of what is allowed to it, and how much of it.
    """

    sync_rate_hz: float
    speed_rad_per_s: FloatArray
    still: bool
    held_s: float
    needed_s: float
    worst_joint: int
    spread_share: float


class MotionWatch:
    """Looks on; called by one thread. `capture` has the settle rule."""

    def __init__(self, arm: ArmModel, capture: CapturePlan) -> None:
        self._allowed = np.array(capture.settle.spread_rad(arm))
        self._window = capture.settle.window_syncs
        self._needed = self._window + capture.samples_per_pose
        self._looks: deque[tuple[float, int, FloatArray]] = deque()
        self._still_since_s: float | None = None

    def forget(self) -> None:
        """Begin anew, after a gap in the data."""
        self._looks.clear()
        self._still_since_s = None

    def see(self, now_s: float, arm: ArmSnapshot) -> Motion:
        """Take in another look."""
        looks = self._looks
        looks.append((now_s, arm.sync_count, arm.positions_rad))
        while now_s - looks[0][0] > RATE_WINDOW_S:
            looks.popleft()
        elapsed = now_s - looks[0][0]
        rate = (arm.sync_count - looks[0][1]) / elapsed if elapsed > 0.0 else 0.0
        # Four looks at least: where SYNCs come quickly the window may hold one, which spreads nothing.
        late = [q for _, sync, q in looks if arm.sync_count - sync < self._window]
        recent = np.array(late if len(late) >= FEWEST else [q for _, _, q in looks][-FEWEST:])
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
        late = [(t, q) for t, _, q in self._looks if now_s - t <= SPEED_WINDOW_S]
        t = np.array([t for t, _ in late])
        q = np.array([q for _, q in late])
        t = t - t.mean()
        square = float(t @ t)
        return t @ (q - q.mean(axis=0)) / square if square > 0.0 else np.zeros(q.shape[1])
