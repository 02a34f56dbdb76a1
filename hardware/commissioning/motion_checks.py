"""Requirements on a moving arm: it reaches targets, and is halted by a watch, by Ctrl-C and by STOP.

As `hardware.commissioning.clauses`, for `sarcal arm-check` and for the contract test of other packages.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from hardware.arm import Arm, ArmSnapshot, DriveState, MoveResult, Watch
from hardware.commissioning.clauses import (
    STOPS_WITHIN_S,
    is_still,
    resets_unmoved,
    seconds_to_stop,
    stays_stopped,
)
from hardware.commissioning.finding import Bounds, Clause, deg
from hardware.errors import Stopped

_WINDOW, _LONG_SYNCS = 5, 1000
_IN_FLIGHT_S: Final = 0.5
"""Time for an interrupt to arrive."""
ENOUGH: Final = "that is enough"


@dataclass(slots=True)
class OnTheWay:
    """A watch that acts once after a part of the motion, and keeps the position."""

    joint: int
    after_rad: float
    act: Callable[[], str | None]
    start_rad: float
    at_rad: float | None = None

    def __call__(self, snapshot: ArmSnapshot) -> str | None:
        """Check a sample of the move."""
        here = float(snapshot.positions_rad[self.joint - 1])
        if self.at_rad is not None or abs(here - self.start_rad) < self.after_rad:
            return None
        self.at_rad = here
        return self.act()


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn:
    """Motion of one joint, and its limits; `part_rad` is the travel after which a watch acts."""

    arm: Arm
    joint: int
    target_rad: float
    speed_rad_per_s: float
    bounds: Bounds
    part_rad: float = 0.0

    def go(self, watch: Watch | None = None) -> MoveResult:
        """Move the joint."""
        return self.arm.move(
            {self.joint: self.target_rad}, speed_rad_per_s=self.speed_rad_per_s, watch=watch
        )

    def on_the_way(self, act: Callable[[], str | None]) -> OnTheWay:
        """Make a watch that acts once after `part_rad`."""
        start = float(self.arm.capture(self.bounds.samples).mean_rad[self.joint - 1])
        return OnTheWay(joint=self.joint, after_rad=self.part_rad, act=act, start_rad=start)

    def ran_on(self, watch: OnTheWay) -> str:
        """Travel after the watch acted, as text."""
        here = float(self.arm.capture(1).mean_rad[self.joint - 1])
        at = watch.start_rad if watch.at_rad is None else watch.at_rad
        return f"came to rest {deg(abs(here - at))} on"


def goes(turn: Turn) -> Iterator[Clause]:
    """It reaches its target and comes to rest."""
    arm, joint, bounds = turn.arm, turn.joint, turn.bounds
    start = arm.capture(bounds.samples).mean_rad
    way = turn.target_rad - float(start[joint - 1])
    moved = turn.go()
    spread = [bounds.once_rad] * len(start)
    rests = arm.settle(window=_WINDOW, spread_rad=spread, timeout_syncs=_LONG_SYNCS)
    went = float(arm.capture(bounds.samples).mean_rad[joint - 1] - start[joint - 1])
    passed = moved.reached and rests and abs(went - way) <= bounds.near_rad
    why = "" if moved.reached else f", and reports {moved.reason!r}"
    yield Clause(
        name="moves",
        passed=passed,
        text=f"commanded to turn by {deg(way, sign=True)}, it reads {deg(went, sign=True)}{why}"
        + ("" if rests else ", and does not come to rest"),
        joint=joint,
    )


def halts(turn: Turn) -> Iterator[Clause]:
    """A watch ends the move with its reason."""
    watch = turn.on_the_way(lambda: ENOUGH)
    moved = turn.go(watch)
    halted = not moved.reached and moved.reason == ENOUGH
    yield Clause(
        name="halts",
        passed=halted,
        text=f"a watch ended the move; it {turn.ran_on(watch)}"
        if halted
        else f"a watch could not end the move, which reports {moved.reason!r}",
        joint=turn.joint,
    )


def is_interrupted(turn: Turn, interrupt: Callable[[], None]) -> Iterator[Clause]:
    """Ctrl-C in a move leaves the arm holding with its drives on."""

    def press() -> None:
        interrupt()

    watch = turn.on_the_way(press)
    interrupted = False
    try:
        turn.go(watch)
        threading.Event().wait(_IN_FLIGHT_S)
    except KeyboardInterrupt:
        if watch.at_rad is None:  # the user's own
            raise
        interrupted = True
    found = turn.arm.snapshot()
    enabled = all(j.drive is DriveState.OPERATION_ENABLED for j in found.joints)
    text = "it was not interrupted"
    if interrupted:
        text = f"it {turn.ran_on(watch)}, its drives {'on' if enabled else 'off'}"
    passed = interrupted and enabled and not found.moving
    yield Clause(name="Ctrl-C", passed=passed, text=text, joint=turn.joint)
    first, then = (turn.arm.capture(turn.bounds.samples).mean_rad for _ in range(2))
    yield from is_still("held", first, then, turn.bounds)


def is_stopped(turn: Turn) -> Iterator[Clause]:
    """STOP from another thread ends a move and latches; its reset causes no motion and leaves the drives off."""
    arm, joint, bounds = turn.arm, turn.joint, turn.bounds

    def press() -> None:
        presser = threading.Thread(target=arm.stop)
        presser.start()
        presser.join()

    watch = turn.on_the_way(press)
    try:
        turn.go(watch)
        stopped = False
    except Stopped:
        stopped = True
    seconds = seconds_to_stop(arm, time.monotonic())
    rests = arm.snapshot().positions_rad  # a stopped arm cannot be captured
    gone = abs(float(rests[joint - 1]) - watch.start_rad)
    at = 0.0 if watch.at_rad is None else abs(watch.at_rad - watch.start_rad)
    text = f"it came to rest {deg(abs(gone - at))} after STOP"
    if seconds is None:
        text = f"a drive is still enabled {STOPS_WITHIN_S:g} s after STOP"
    yield Clause(
        name="STOP on the way",
        passed=stopped and seconds is not None and gone - at <= max(turn.part_rad, bounds.once_rad),
        text=text if stopped else "it was not stopped",
        joint=joint,
    )
    yield from stays_stopped(arm, joint, turn.speed_rad_per_s)
    yield from resets_unmoved(arm, rests, bounds)


def moved_alone(before: np.ndarray, after: np.ndarray, joint: int, bounds: Bounds) -> Clause:
    """No other joint moved."""
    others = np.delete(np.abs(after - before), joint - 1)
    most = float(others.max(initial=0.0))
    return Clause(
        name="alone",
        passed=most <= max(bounds.still_rad, bounds.near_rad),
        text=f"no other joint moved by more than {deg(most)}",
        joint=joint,
    )
