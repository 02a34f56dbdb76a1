"""What happens to frames on a bad bus: lost, doubled, swapped, late, flipped, drowned. Knows no node.

A `FaultyWire` is one direction; a bus that is bad is bad both ways, and has two.
"""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass

import can
import numpy as np

BABBLE_ID = 0x7EE
"""An identifier that nobody of the arm uses."""

LATE_S = (0.005, 0.05)
"""A late frame comes between so much and so much later."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameFaults:
    """Shares of all frames (0 to 1) that something happens to; `babble` frames of nobody's after each."""

    lost: float = 0.0
    doubled: float = 0.0
    swapped: float = 0.0
    late: float = 0.0
    flipped: float = 0.0
    babble: float = 0.0


class FaultyWire:
    """Frames in, frames out as the faults have it; the same for a seed, but for when late ones come.

    `delays` says whether frames may wait here.
    """

    def __init__(
        self, faults: FrameFaults, seed: int = 0, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._faults, self._rng, self._clock = faults, np.random.default_rng(seed), clock
        self._held: can.Message | None = None
        self._late: list[tuple[float, int, can.Message]] = []
        self._count = 0
        self.delays = faults.late > 0.0

    def passed(self, message: can.Message) -> Iterator[can.Message]:
        """Frames that go out when this one is sent."""
        faults = self._faults
        lost, doubled, swapped, flipped, late = self._rng.random(5)
        if lost < faults.lost:
            return
        if flipped < faults.flipped and len(message.data):
            message = copy(message)  # whoever else is on the bus has the same object
            message.data = bytearray(message.data)
            bit = int(self._rng.integers(8 * len(message.data)))
            message.data[bit // 8] ^= 1 << bit % 8
        if swapped < faults.swapped and self._held is None:
            self._held = message
            return
        if late < faults.late:
            self._count += 1
            due_s = self._clock() + self._rng.uniform(*LATE_S)
            heapq.heappush(self._late, (due_s, self._count, message))
            return
        yield message
        if doubled < faults.doubled:
            yield message
        held, self._held = self._held, None
        if held is not None:
            yield held
        for _ in range(round(faults.babble)):
            yield can.Message(arbitration_id=BABBLE_ID, data=b"babble", is_extended_id=False)

    def overdue(self) -> Iterator[can.Message]:
        """Late frames whose time has come."""
        while self._late and self._late[0][0] <= self._clock():
            yield heapq.heappop(self._late)[2]
