"""How late we are ourselves: nobody here listened, or what came waits. Knows time stamps; no bus and no node.

On a busy machine the thread that receives may not run for a second. Whatever the arm said meanwhile
waits in a queue; to call the arm silent would be to take one's own lateness for its silence, and to call
fresh what has waited there would be to take the moment of reading for that of the message.
"""

from __future__ import annotations

from collections.abc import Callable

from hardware.arm import Lateness

LONGEST_LOOK_S = 0.1
"""Between two looks at the bus no more than this counts as listening: the longest that the loop waits
for a frame, with room for an ordinary scheduler."""
TOLD_S = 0.3
"""So long a lateness is told to the operator: drives trip when they hear nothing of us for half a second."""


class Attention:
    """Counts lateness; the thread that receives says each time that it looks at the bus, and what it found.

    How long a frame waited is the difference of two readings of one clock: that by which it was stamped as it
    came, and the same one now. That clock may be set anew meanwhile, so a frame is never older than the last
    moment at which nothing was waiting. Where frames are stamped by another clock, or not at all, a frame came
    when it was read.

    Parameters
    ----------
    clock
        Monotonic time, s.
    stamps
        The clock that stamps frames as they come; None where that is none of this computer's.
    arm_waits
        Whether the arm's time stands while we are busy (`Pace.FAST_FORWARD`): then nobody is late.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        stamps: Callable[[], float] | None = None,
        *,
        arm_waits: bool = False,
    ) -> None:
        self._clock, self._stamps, self._arm_waits = clock, stamps, arm_waits
        self._lateness = Lateness()
        self.begin()

    def begin(self) -> None:
        """Count from now on."""
        now = self._clock()
        # Replaced as a whole: readers in other threads see time and lateness that belong together.
        self._last = (now, 0.0)
        self._nothing_at_s = now
        self._late_now = False

    def look(self, stamp_s: float = 0.0) -> float:
        """Note that a frame is being looked at now; return how long it waited for us. A stamp of 0 is none."""
        now = self._clock()
        waited_s = 0.0
        if self._stamps is not None and stamp_s:
            waited_s = max(0.0, min(self._stamps() - stamp_s, now - self._nothing_at_s))
        self._note(now, waited_s)
        return waited_s

    def nothing(self, asked_s: float) -> None:
        """Note that nothing was waiting when we asked, at that time, nor came as long as we then waited."""
        self._note(self._clock(), 0.0)
        self._nothing_at_s = asked_s
        self._late_now = False

    @property
    def lateness(self) -> Lateness:
        """How late we have been, as far as it is worth telling."""
        return self._lateness

    @property
    def late_s(self) -> float:
        """Seconds in all that nobody listened, up to now."""
        return self._late_at(self._clock())

    @property
    def listened_s(self) -> float:
        """The clock without the time in which nobody listened: what silences are measured by."""
        now = self._clock()
        return now - self._late_at(now)

    def _note(self, now: float, waited_s: float) -> None:
        by_s = max(now - self._last[0], waited_s)
        self._last = (now, self._late_at(now))
        if by_s >= TOLD_S and not self._arm_waits:
            self._lateness = self._lateness.once_more(by_s, new=not self._late_now)
            self._late_now = True

    def _late_at(self, now: float) -> float:
        last, late = self._last
        return late + max(0.0, now - last - LONGEST_LOOK_S)
