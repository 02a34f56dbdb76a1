"""Makes one sample of what the joints answer to one SYNC, and publishes it. Knows no bus and no clock."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from hardware.cyclic import Sample, unpack_status

DOUBLED_SYNCS = 10
"""Frames may come twice now and then; whoever is so many answers ahead of one a SYNC is two."""

SPEED_SYNCS = 5
"""Speeds are means over this many control periods."""


@dataclass(frozen=True, slots=True)
class View:
    """What other threads see of the cyclic traffic, replaced as a whole after every sample.

    `late_at_s` is how late the loop had been in all when each joint answered.
    """

    sample: Sample
    earlier: Sample
    answered_at_s: tuple[float, ...]
    late_at_s: tuple[float, ...]


class Sampler:
    """Collects the answers of joints 1..`joints`.

    A joint that missed `patience` samples in a row is lost: it is no longer waited for, and comes
    back with its next answer.

    Attributes
    ----------
    view
        The latest sample, to be read from any thread.
    waiting
        Joints whose answer to the present SYNC is still expected.
    """

    def __init__(self, joints: int, *, patience: int, now_s: float) -> None:
        self._joints, self._patience = joints, patience
        self._status = [0] * joints
        self._counts = [0] * joints
        self._torques = [0] * joints
        self._answered_at_s = [now_s] * joints
        self._late_at_s = [0.0] * joints
        self._answers = [0] * joints
        self._missed = [0] * joints
        self._doubled = [0] * joints
        blank = Sample(
            sync_count=0,
            statuswords=tuple(self._status),
            counts=tuple(self._counts),
            torques_per_mille=tuple(self._torques),
            missing=tuple(range(1, joints + 1)),
        )
        self._history: deque[Sample] = deque(maxlen=SPEED_SYNCS)
        self.view = View(blank, blank, tuple(self._answered_at_s), tuple(self._late_at_s))
        self.waiting = 0

    def open(self) -> None:
        """Begin a sample: a SYNC is about to go out."""
        # A second answer may have come after the sample was closed: it is looked at only now. It may
        # also come after the next SYNC, and be counted there: what is too many in one sample is kept,
        # and a sample with one answer takes only one of it away.
        for at, answers in enumerate(self._answers):
            surplus = answers - 1 if answers > 1 else -1
            self._doubled[at] = min(max(self._doubled[at] + surplus, 0), DOUBLED_SYNCS)
        self._answers = [0] * self._joints
        self.waiting = sum(missed < self._patience for missed in self._missed)

    def note(self, joint: int, data: bytes | bytearray, now_s: float, late_s: float = 0.0) -> None:
        """Take in a joint's TPDO1; one of another length is not looked at.

        `late_s` is how late the loop has been in all.
        """
        status = unpack_status(data)
        if status is None:
            return
        at = joint - 1
        self._status[at], self._counts[at], self._torques[at] = status
        self._answered_at_s[at] = now_s
        self._late_at_s[at] = late_s
        self._answers[at] += 1
        if self._missed[at] >= self._patience:
            # It was not waited for: this answer may come after its sample was closed, and counts.
            self._missed[at] = 0
        elif self._answers[at] == 1:
            self.waiting -= 1

    def close(self) -> None:
        """End the sample and publish it."""
        for at, answers in enumerate(self._answers):
            self._missed[at] = 0 if answers else self._missed[at] + 1
        sample = Sample(
            sync_count=self.view.sample.sync_count + 1,
            statuswords=tuple(self._status),
            counts=tuple(self._counts),
            torques_per_mille=tuple(self._torques),
            # Two answers in one window: one of them is late and belongs to another SYNC.
            missing=tuple(j for j, answers in enumerate(self._answers, 1) if answers != 1),
        )
        earlier = self._history[0] if self._history else sample
        self._history.append(sample)
        self.view = View(sample, earlier, tuple(self._answered_at_s), tuple(self._late_at_s))

    def doubled(self) -> tuple[int, ...]:
        """Joints that go on answering a SYNC more than once."""
        return tuple(j for j, times in enumerate(self._doubled, 1) if times >= DOUBLED_SYNCS)

    def lost(self) -> tuple[int, ...]:
        """Joints that are no longer waited for."""
        return tuple(j for j, missed in enumerate(self._missed, 1) if missed >= self._patience)
