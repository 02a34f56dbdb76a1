"""Makes one sample of what the joints answer to one SYNC, and publishes it. Knows no bus and no clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from hardware.canopen.cyclic import MAX_LATE_SYNCS, JointFrames, Sample

DOUBLED_SYNCS = 10
"""Frames may come twice now and then; whoever is so many answers ahead of one a SYNC is two."""

SPEED_SYNCS = 5
"""Speeds are means over this many control periods."""


@dataclass(frozen=True, slots=True)
class CyclicView:
    """What other threads see of the cyclic traffic, replaced as a whole after every sample.

    `late_at_s` is how late the loop had been in all when each joint answered.
    """

    sample: Sample
    earlier: Sample
    answered_at_s: tuple[float, ...]
    late_at_s: tuple[float, ...]


class Sampler:
    """Collects the answers of joints 1..n, whose frames are given.

    A joint has answered when each of its TPDOs has come.

    A joint that missed `patience` samples in a row is lost: it is no longer waited for, and comes
    back with its next answer.

    Attributes
    ----------
    view
        The latest sample, to be read from any thread.
    waiting
        Joints whose answer to the present SYNC is still expected.
    answered_late
        A joint had answered after the sample before was closed: what was taken for its answer there
        may have been one to an earlier SYNC.
    """

    def __init__(self, frames: Sequence[JointFrames], *, patience: int, now_s: float) -> None:
        joints = len(frames)
        self._patience = patience
        self._parts = {
            identifier: (at, part, answer)
            for at, joint in enumerate(frames)
            for part, (identifier, answer) in enumerate(joint.answers.items())
        }
        self._blank = [(0,) * len(joint.answers) for joint in frames]
        self._came = [list(none) for none in self._blank]
        self._closed = [list(none) for none in self._blank]
        # Statusword, counts, torque.
        self._states = [[0, 0, 0] for _ in frames]
        self._answered_at_s = [now_s] * joints
        self._late_at_s = [0.0] * joints
        self._missed = [0] * joints
        self._awaited = [False] * joints
        self._doubled = [0] * joints
        self._owed = [0] * joints
        blank = Sample(
            sync_count=0,
            **self._columns(),
            missing=tuple(range(1, joints + 1)),
        )
        self._history: deque[Sample] = deque(maxlen=SPEED_SYNCS)
        self.view = CyclicView(blank, blank, tuple(self._answered_at_s), tuple(self._late_at_s))
        self.waiting = 0
        self.answered_late = False

    def open(self) -> None:
        """Begin a sample: a SYNC is about to go out."""
        self.answered_late = any(
            came != closed for came, closed in zip(self._came, self._closed, strict=True)
        )
        # A second answer may have come after the sample was closed: it is looked at only now. It may
        # also come after the next SYNC, and be counted there: what is too many in one sample is kept,
        # and a sample with one answer takes only one of it away.
        for at, came in enumerate(self._came):
            answers = max(came)
            # Whoever was held up answers all that he owes at once, or now and then: meanwhile he may have
            # answered every SYNC once, each time to an earlier one.
            late = min(self._owed[at], max(answers - 1, 0))
            self._owed[at] = min(self._owed[at] - late + (answers == 0), MAX_LATE_SYNCS)
            surplus = answers - 1 - late if answers - late > 1 else -1
            self._doubled[at] = min(max(self._doubled[at] + surplus, 0), DOUBLED_SYNCS)
            came[:] = self._blank[at]
        self._awaited = [missed < self._patience for missed in self._missed]
        self.waiting = sum(self._awaited)

    def note(
        self, identifier: int, data: bytes | bytearray, now_s: float, late_s: float = 0.0
    ) -> bool:
        """Take in a frame if it is a TPDO of a joint; whether it is. One of another length says nothing.

        `late_s` is how late the loop has been in all.
        """
        found = self._parts.get(identifier)
        if found is None:
            return False
        at, part, answer = found
        if not answer.read_into(self._states[at], data):
            return True
        self._answered_at_s[at] = now_s
        self._late_at_s[at] = late_s
        came = self._came[at]
        came[part] += 1
        if self._missed[at] >= self._patience:
            # It was not waited for: this answer may come after its sample was closed, and counts.
            self._missed[at] = 0
        elif self._awaited[at] and came[part] == min(came) == 1:
            self.waiting -= 1
        return True

    def close(self) -> None:
        """End the sample and publish it."""
        self._closed = [list(came) for came in self._came]
        for at, came in enumerate(self._came):
            self._missed[at] = 0 if min(came) else self._missed[at] + 1
        sample = Sample(
            sync_count=self.view.sample.sync_count + 1,
            **self._columns(),
            # Two answers in one window: one of them is late and belongs to another SYNC.
            missing=tuple(
                j for j, came in enumerate(self._came, 1) if not min(came) == max(came) == 1
            ),
        )
        earlier = self._history[0] if self._history else sample
        self._history.append(sample)
        self.view = CyclicView(sample, earlier, tuple(self._answered_at_s), tuple(self._late_at_s))

    def doubled(self) -> tuple[int, ...]:
        """Joints that go on answering a SYNC more than once."""
        return tuple(j for j, times in enumerate(self._doubled, 1) if times >= DOUBLED_SYNCS)

    def lost(self) -> tuple[int, ...]:
        """Joints that are no longer waited for."""
        return tuple(j for j, missed in enumerate(self._missed, 1) if missed >= self._patience)

    def _columns(self) -> dict[str, tuple[int, ...]]:
        statuswords, counts, torques = zip(*self._states, strict=True)
        return {"statuswords": statuswords, "counts": counts, "torques_per_mille": torques}
