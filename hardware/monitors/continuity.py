"""Does every joint's count go on as it went? Sees lost counts as they happen. Knows samples, no bus and no loop.

A joint's position is smooth from SYNC to SYNC: what it did in one period follows from the two before and
the two after it. One step beside that, in one joint alone, with quiet before and after it, is neither
noise nor a motion of a closed chain, in which nothing moves alone: counts were lost, or a coupling slipped.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from hardware.canopen.cyclic import Sample

SPAN = 6
"""Samples, of SYNCs in a row, that a judgement takes: the step in question is in their middle."""

ENCODER_COUNTS = 4.0
"""At rest. Rounding of six readings makes an encoder's step seem larger by two counts at the most."""
RVDT_COUNTS = 64.0
"""An RVDT's noise of two of its steps, twelve times: 1.9 deg for 12 bits over 120 deg."""

COMPANY, LEAST_COMPANY = 0.1, 0.6
"""Where something real has jerked, another joint shows some of it: so much of the jump, or of its noise."""

MOVING = 6.0
"""Times the noise that a step has to be larger in motion: targets do not come quite as regularly as SYNC."""

TAKING_UP_SYNCS = 15
"""A drive that was enabled, or holds anew, takes its joint up or lets it give way, for so long."""

QUIET_SYNCS, ITSELF_SYNCS = 10, 2
"""Noise does not come alone: nothing else within so many SYNCs, but what the step itself looks like."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Jump:
    """A joint's reading went on by so many counts more than its motion, with the answer to a SYNC."""

    joint: int
    counts: int
    sync_count: int


class Continuity:
    """Looks at every sample.

    Parameters
    ----------
    allowed_counts
        By joint: step that is noise.
    """

    def __init__(self, allowed_counts: Sequence[float]) -> None:
        self._allowed = tuple(allowed_counts)
        self._recent: deque[tuple[int, ...]] = deque(maxlen=SPAN)
        self._last_sync = -1
        self._states: tuple[int, ...] = ()
        self._odd: tuple[deque[int], ...] = tuple(
            deque(maxlen=2 * QUIET_SYNCS) for _ in self._allowed
        )
        self._suspect: Jump | None = None
        self._taking_up = 0

    def disturb(self) -> None:
        """Hear that a drive is being enabled, given another mode or a target at once: its joint may well jerk."""
        self._taking_up = TAKING_UP_SYNCS
        self._suspect = None

    def interrupt(self) -> None:
        """Hear that the last sample may hold older answers than it seems: no step is measured from it."""
        self._recent.clear()

    def see(self, sample: Sample) -> Jump | None:
        """Take in a sample; the jump that is certain by now, if there is one."""
        recent = self._recent
        if (
            not sample.complete
            or sample.sync_count != self._last_sync + 1
            or sample.statuswords != self._states
        ):
            recent.clear()
        self._last_sync, self._states = sample.sync_count, sample.statuswords
        if self._taking_up > 0:
            self._taking_up -= 1
            recent.clear()
            return None
        if sample.complete:
            recent.append(sample.counts)
            if len(recent) == SPAN:
                before, now, allowed = recent[2], recent[3], self._allowed
                for at, was in enumerate(before):
                    # Quick: most steps are like the one before them.
                    if abs(now[at] - 2 * was + recent[1][at]) > allowed[at]:
                        self._judge(sample.sync_count - 2)
                        break
        suspect = self._suspect
        if suspect is None or sample.sync_count < suspect.sync_count + QUIET_SYNCS:
            return None
        self._suspect = None
        odd = (abs(sync - suspect.sync_count) for sync in self._odd[suspect.joint - 1])
        return None if any(ITSELF_SYNCS < away <= QUIET_SYNCS for away in odd) else suspect

    def _judge(self, sync_count: int) -> None:
        """Look at the step that ended with the answer to this SYNC."""
        found: list[Jump] = []
        beside = []
        rests = all(
            abs(a - b) <= allowed
            for one, two in ((0, 1), (1, 2), (3, 4), (4, 5))
            for a, b, allowed in zip(
                self._recent[one], self._recent[two], self._allowed, strict=True
            )
        )
        for at, allowed in enumerate(self._allowed):
            c0, c1, c2, c3, c4, c5 = (counts[at] for counts in self._recent)
            d0, d1, d2, d3, d4 = c1 - c0, c2 - c1, c3 - c2, c4 - c3, c5 - c4
            # A cubic through the four others.
            step = d2 - (4 * (d1 + d3) - d0 - d4) / 6.0
            beside.append(abs(step) / allowed)
            if abs(step) > allowed:
                self._odd[at].append(sync_count)
            # What changes its speed by itself may do so in the very period as well.
            restless = max(abs(d1 - d0), abs(d4 - d3), abs(d3 - d1))
            if abs(step) > (allowed if rests else MOVING * allowed) + restless:
                found.append(Jump(joint=at + 1, counts=round(step), sync_count=sync_count))
        if len(found) != 1 or self._suspect is not None:
            return
        (jump,) = found
        for at, (times, allowed) in enumerate(zip(beside, self._allowed, strict=True)):
            if (
                at != jump.joint - 1
                and times > LEAST_COMPANY + COMPANY * abs(jump.counts) / allowed
            ):
                return
        self._suspect = jump
