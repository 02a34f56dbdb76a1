"""Pace and time-outs of the cyclic traffic.

`REAL_TIME`: a SYNC every control period. `FAST_FORWARD`: SYNCs only while steps run, each as soon as all joints
have answered the one before; a run on a seeded virtual arm is then reproducible.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

from hardware.canopen.objects import CONTROL_PERIOD_S, HEARTBEAT_PERIOD_S


class Pace(Enum):
    """When the next SYNC is sent."""

    REAL_TIME = "real time"
    FAST_FORWARD = "fast forward"


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """Periods and time-outs of the control loop.

    Attributes
    ----------
    sdo_timeout_s
        Time-out of every SDO answer.
    answer_timeouts_s
        Time-out of a joint's answer to SYNC; longer in fast forward, where simulated time stands still meanwhile.
    min_misses, lost_after_s
        A joint is lost after this many consecutive misses and this silence; until then a move waits.
    idle_poll_s
        First wait of an idle loop for a task; later ones are longer.
    speed
        Factor by which a simulated arm runs faster than its clock; 1 for a real one.
    """

    period_s: float = CONTROL_PERIOD_S
    heartbeat_period_s: float = HEARTBEAT_PERIOD_S
    heartbeat_timeout_s: float = 1.0
    sdo_timeout_s: float = 1.0
    answer_timeouts_s: Mapping[Pace, float] = field(
        default_factory=lambda: {Pace.REAL_TIME: 0.03, Pace.FAST_FORWARD: 0.5}
    )
    min_misses: int = 3
    lost_after_s: float = 1.0
    idle_poll_s: float = 0.002
    speed: float = 1.0

    @property
    def tick_s(self) -> float:
        """Wall-clock time between SYNCs."""
        return self.period_s / self.speed

    def misses(self, pace: Pace) -> int:
        """Consecutive SYNCs that a joint may miss before it is lost."""
        return max(self.min_misses, round(self.lost_after_s / self.answer_timeouts_s[pace]))
