"""How much of a silence, and of a frame's age, is our own: nobody here listened. Knows no bus and no node.

On a busy machine the thread that receives may not run for a second. Whatever the arm said meanwhile
waits in a queue; to call the arm silent would be to take one's own lateness for its silence.
"""

from __future__ import annotations

from collections.abc import Callable

LONGEST_LOOK_S = 0.1
"""Between two looks at the bus no more than this counts as listening: the longest that the loop waits
for a frame, with room for an ordinary scheduler."""
TOLD_S = 0.3
"""The operator is told of so long a lateness: drives trip when they hear nothing of us for half a second."""
WORSE = 2.0
"""And again only of one that is so much longer than what was told."""


class Attention:
    """Counts lateness; `look` is called by the thread that receives, each time it looks at the bus.

    Parameters
    ----------
    clock
        Monotonic time, s.

    Attributes
    ----------
    words
        What the operator should know of it, in a sentence; "" while we were never late.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self.words = ""
        self._told_s = 0.0
        # Replaced as a whole: readers in other threads see time and lateness that belong together.
        self._last = (clock(), 0.0)

    def look(self) -> None:
        """Note that what has arrived is being looked at now."""
        now, before_s = self._clock(), self._last[1]
        self._last = (now, self._late_at(now))
        late_s = self._last[1] - before_s
        if late_s >= max(TOLD_S, WORSE * self._told_s):
            self._told_s = late_s
            self.words = (
                f"this computer was too busy: for {late_s:.1f} s nobody here listened to the arm or told it "
                "anything new. What came meanwhile counts as old; the session goes on. End other programs on it"
            )

    def begin(self) -> None:
        """Count from now on."""
        self._last = (self._clock(), 0.0)

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


class Waiting:
    """How long a frame waited for us before it was looked at: by its time stamp, whatever clock that is of.

    A stamp's clock may have any zero, run a little fast or slow, or be set anew. What is sure is that a frame
    cannot have come before we last found nothing waiting. So its stamp is one of a moment between that and now,
    and the difference of the two clocks is kept where no frame contradicts it. Without stamps a frame counts
    as old as it may be.

    Parameters
    ----------
    stamped
        Frames are stamped as they arrive, and not as they are read.
    now_s
        When nothing has come yet.
    """

    def __init__(self, *, stamped: bool, now_s: float) -> None:
        self._stamped, self._nothing_at_s = stamped, now_s
        self._zero_s: float | None = None

    def nothing(self, at_s: float) -> None:
        """Note that at that time nothing was waiting."""
        self._nothing_at_s = at_s

    def waited_s(self, stamp_s: float, now_s: float) -> float:
        """How long a frame has waited that is looked at now; a stamp of 0 is none."""
        longest_s = now_s - self._nothing_at_s
        if not self._stamped or not stamp_s:
            return longest_s
        difference_s = now_s - stamp_s
        if self._zero_s is None:
            self._zero_s = difference_s
        self._zero_s = min(max(self._zero_s, difference_s - longest_s), difference_s)
        return difference_s - self._zero_s
