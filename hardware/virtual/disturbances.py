"""Faults of the frames on the virtual arm's bus."""

import heapq
import time
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass

import can
import numpy as np

BABBLE_ID = 0x7EE
"""Identifier not used by the arm."""

LATE_S = (0.005, 0.05)
"""Range of the delay of late frames, s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFaults:
    """Fractions (0 to 1) of frames with each fault, but `babble` is the number of foreign frames after every frame."""

    lost: float = 0.0
    doubled: float = 0.0
    swapped: float = 0.0
    late: float = 0.0
    flipped: float = 0.0
    babble: float = 0.0


NO_FRAME_FAULTS = FrameFaults()


class FaultyWire:
    """One direction of a bus. The seed determines all faults of frames, but not the times at which late frames arrive.

    `delays`: whether frames may be late.
    """

    def __init__(
        self,
        faults: FrameFaults = NO_FRAME_FAULTS,
        seed: int = 0,
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._faults, self._rng, self._clock = faults, np.random.default_rng(seed), clock
        self._swapped: can.Message | None = None
        self._late: list[tuple[float, int, can.Message]] = []
        self._count = 0
        self.delays, self._is_clean = faults.late > 0.0, faults == NO_FRAME_FAULTS

    def passed(self, message: can.Message) -> Iterator[can.Message]:
        """Yield the frames that come out of the wire when `message` is put in."""
        if self._is_clean:
            yield message
            return
        faults = self._faults
        lost, doubled, swapped, flipped, late = self._rng.random(5)
        if lost < faults.lost:
            return
        if flipped < faults.flipped and len(message.data):
            message = copy(message)  # other receivers share the object
            message.data = bytearray(message.data)
            bit = int(self._rng.integers(8 * len(message.data)))
            message.data[bit // 8] ^= 1 << bit % 8
        if swapped < faults.swapped and self._swapped is None:
            self._swapped = message
            return
        if late < faults.late:
            self._count += 1
            due_s = self._clock() + self._rng.uniform(*LATE_S)
            heapq.heappush(self._late, (due_s, self._count, message))
            return
        yield message
        if doubled < faults.doubled:
            yield message
        swapped_frame, self._swapped = self._swapped, None
        if swapped_frame is not None:
            yield swapped_frame
        for _ in range(round(faults.babble)):
            yield can.Message(arbitration_id=BABBLE_ID, data=b"babble", is_extended_id=False)

    def overdue(self) -> Iterator[can.Message]:
        """Yield the late frames that are due."""
        while self._late and self._late[0][0] <= self._clock():
            yield heapq.heappop(self._late)[2]
