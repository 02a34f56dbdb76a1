"""Active faults of the virtual arm and of its bus, read on every SYNC."""

import heapq
import math
import time
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass, field

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


DIVERGENCE_STEP_COUNTS, DIVERGENCE_COUNTS = 20, 5556
"""Growth of a divergence per control period, and its final value, which is 5 deg with 400,000 counts per turn."""


@dataclass(slots=True)
class Disturbances:
    """Active faults, by node or joint."""

    cut_since_s: dict[int, float] = field(default_factory=dict)
    """Time at which a node's cable was cut (the controller's clock), by node."""
    no_heartbeat: set[int] = field(default_factory=set)
    heartbeat_period_s: dict[int, float] = field(default_factory=dict)
    """Changed heartbeat periods, by node."""
    lost_tpdos: dict[int, int] = field(default_factory=dict)
    """Number of TPDO1 still to be lost, by joint."""
    doubled_tpdos: set[int] = field(default_factory=set)
    frozen_counts: dict[int, int] = field(default_factory=dict)
    """Constant reading of a stuck sensor, by joint."""
    lost_counts: dict[int, int] = field(default_factory=dict)
    """Offset of a sensor's readings, by joint; the drive follows the changed readings."""
    diverged_counts: dict[int, int] = field(default_factory=dict)
    """Distance of a joint from its drive's target, by joint; the distance grows every control period."""
    ripple_counts: dict[int, float] = field(default_factory=dict)
    """Standard deviation of the noise added to a sensor's readings, by joint."""
    blocked: set[int] = field(default_factory=set)
    sagging: set[int] = field(default_factory=set)
    """Joints that do not move in free mode (`blocked`), and joints that do not hold in position mode."""
    storming: set[int] = field(default_factory=set)
    stalled_sdo: set[int] = field(default_factory=set)
    refused_sdo: set[int] = field(default_factory=set)
    off_until_s: float | None = None
    """Time until which no frame passes (the controller's clock); None if frames pass."""
    wire_out: FaultyWire = field(default_factory=FaultyWire)
    wire_in: FaultyWire = field(default_factory=FaultyWire)
    """Directions from and to the arm, with their faults."""
    _next_beat_s: dict[int, float] = field(default_factory=dict)
    _rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    @property
    def delays(self) -> bool:
        """Whether a wire delays frames."""
        return self.wire_out.delays or self.wire_in.delays

    def sends_heartbeat(self, node: int, now_s: float) -> bool:
        """Whether a node sends the heartbeat that is due now; a node with a longer period skips some of them."""
        if node in self.no_heartbeat:
            return False
        period_s = self.heartbeat_period_s.get(node)
        if period_s is None:
            return True
        if now_s < self._next_beat_s.get(node, -math.inf):
            return False
        self._next_beat_s[node] = now_s + period_s
        return True

    def read(self, joint: int, counts: int) -> int:
        """Return a sensor's reading with the joint's active faults; `counts`: the reading without faults."""
        if joint in self.frozen_counts:
            return self.frozen_counts[joint]
        ripple = self.ripple_counts.get(joint, 0.0)
        noise = round(self._rng.normal(0.0, ripple)) if ripple else 0
        return counts + self.lost_counts.get(joint, 0) + noise

    def loses_tpdo(self, joint: int) -> bool:
        """Whether the TPDO1 that a joint is about to send is lost; if so, `lost_tpdos` is reduced by one."""
        remaining = self.lost_tpdos.get(joint, 0)
        self.lost_tpdos[joint] = max(0, remaining - 1)
        return remaining > 0

    def divergence(self, joint: int) -> int:
        """Return a joint's simulated deviation from its target, counts; each call increases it, up to a limit."""
        counts = self.diverged_counts.get(joint)
        if counts is None:
            return 0
        self.diverged_counts[joint] = min(counts + DIVERGENCE_STEP_COUNTS, DIVERGENCE_COUNTS)
        return counts
