"""How fast the cyclic traffic goes, and how long anybody is waited for. Knows no bus and no thread.

Two paces. `REAL_TIME`: a SYNC every control period, always. `FAST_FORWARD`: SYNCs only while steps
are being run, each as soon as all joints have answered the one before; the number of SYNCs then
depends on nothing but the samples, so a run on a seeded virtual arm is the same every time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from hardware.canopen.objects import CONTROL_PERIOD_S, HEARTBEAT_PERIOD_S


class Pace(Enum):
    """When the next SYNC goes out."""

    REAL_TIME = "real time"
    FAST_FORWARD = "fast forward"


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Periods and patience of the loop: seconds, `patience` in SYNCs.

    A joint has `answer_timeouts_s` for its answer; in real time the others' next SYNC waits no longer than
    that for one that does not answer. Simulated time does not pass meanwhile, so that in
    fast forward a slow machine may take longer. A joint is lost when it missed `patience` SYNCs in
    a row and has been silent for `lost_after_s`; until then a move waits where it is.

    A loop that has nothing to do looks for a task after `idle_poll_s`, then less and less often.

    A node has `sdo_timeout_s` for every answer to an object access.

    `speed` is how many times faster than its own clock a simulated arm runs; a real one knows only 1.
    """

    period_s: float = CONTROL_PERIOD_S
    heartbeat_period_s: float = HEARTBEAT_PERIOD_S
    heartbeat_timeout_s: float = 1.0
    sdo_timeout_s: float = 1.0
    answer_timeouts_s: Mapping[Pace, float] = field(
        default_factory=lambda: {Pace.REAL_TIME: 0.03, Pace.FAST_FORWARD: 0.5}
    )
    patience: int = 3
    lost_after_s: float = 1.0
    idle_poll_s: float = 0.002
    speed: float = 1.0

    @property
    def tick_s(self) -> float:
        """Wall-clock time between SYNCs."""
        return self.period_s / self.speed

    def misses(self, pace: Pace) -> int:
        """SYNCs in a row that a joint may miss before it is lost."""
        return max(self.patience, round(self.lost_after_s / self.answer_timeouts_s[pace]))
