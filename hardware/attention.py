"""How much of a silence is our own: time that passed while nobody here listened. Knows no bus and no node.

On a busy machine the thread that receives may not run for a second. Whatever the arm said meanwhile
waits in a queue; to call the arm silent would be to take one's own lateness for its silence.
"""

from __future__ import annotations

from collections.abc import Callable

LONGEST_LOOK_S = 0.1
"""Between two looks at the bus no more than this counts as listening: the longest that the loop waits
for a frame, with room for an ordinary scheduler."""


class Attention:
    """Counts lateness; `look` is called by the thread that receives, each time it looks at the bus.

    Parameters
    ----------
    clock
        Monotonic time, s.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        # Replaced as a whole: readers in other threads see time and lateness that belong together.
        self._last = (clock(), 0.0)

    def look(self) -> None:
        """Note that what has arrived is being looked at now."""
        now = self._clock()
        self._last = (now, self._late_at(now))

    @property
    def late_s(self) -> float:
        """Seconds in all that nobody listened, up to now."""
        return self._late_at(self._clock())

    @property
    def listened_s(self) -> float:
        """The clock without the time in which nobody listened: what silences are measured by."""
        now = self._clock()
        return now - self._late_at(now)

    def _late_at(self, now: float) -> float:
        last, late = self._last
        return late + max(0.0, now - last - LONGEST_LOOK_S)
