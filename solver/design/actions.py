"""Proposed actions of a planned calibration, and the check of readings during a move."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.design.motion import Ranges
from solver.design.paths import Leg
from solver.design.stop_rule import WeakParameter

NOISE_RAD = float(np.deg2rad(0.3))
"""A joint whose move starts too close to an end of its range may come closer by this much, for noise of its reading."""
TOLERANCE_RAD = float(np.deg2rad(8.0))
"""Largest deviation of readings from the predicted trace of a planned move."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GoTo:
    """Move the drive joints in a straight line, so that all finish together.

    `targets_rad`: target by joint number (1-based). `why`: reason for the move, for the operator. `trace_rad` (t, n):
    predicted readings of all joints on the way; None if there is no prediction.
    """

    targets_rad: Mapping[int, float]
    why: str
    trace_rad: FloatArray | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Capture:
    """Wait for standstill, then measure a pose. `planned`: whether the pose belongs to the plan, not to exploration."""

    planned: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangeDrives:
    """Stop; put the joints `drives` (1-based) into position mode and all others into free mode."""

    drives: tuple[int, ...]
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Finished:
    """End of the campaign: nothing is left to do.

    `complete`: whether all planned poses were taken or the requested precision was reached. `weak`: parameters that are
    less precise than requested. `text`: why the campaign ended.
    """

    complete: bool
    weak: tuple[WeakParameter, ...]
    text: str


Action = GoTo | Capture | ChangeDrives | Finished


def path_watch(trace_rad: FloatArray | None, ranges: Ranges) -> Callable[[FloatArray], str | None]:
    """Return a function that checks readings (n,), rad, during a move and returns the reason to end it, or None.

    `trace_rad`: predicted readings (t, n); None to check the ranges only. `ranges`: joint ranges, narrowed by the
    stopping distance.
    """
    worst: list[FloatArray] = []

    def watch(q: FloatArray) -> str | None:
        room = np.minimum(q - ranges.lower_rad, ranges.upper_rad - q)
        if not worst:
            # A move that starts too close to an end may lead away from it, but no closer.
            worst.append(np.minimum(0.0, room - NOISE_RAD))
        beyond = room < worst[0]
        if np.any(beyond):
            return f"joint {int(np.argmin(room - worst[0])) + 1} came close to the end of its range"
        if trace_rad is not None:
            apart = np.abs(trace_rad - q)
            nearest = int(np.argmin(apart.max(-1)))
            joint = int(np.argmax(apart[nearest]))
            if apart[nearest, joint] > TOLERANCE_RAD:
                degrees = np.rad2deg(apart[nearest, joint])
                return f"joint {joint + 1} is {degrees:.1f} deg from its predicted angle"
        return None

    return watch


def moves_along(
    route: Sequence[Leg], drives: tuple[int, ...], goal: str, *, of: str = ""
) -> list[GoTo | ChangeDrives]:
    """Return the moves and drive changes along `route`, for an arm whose drive joints are now `drives`.

    `goal`: name of the last pose, for the operator. `of`: text after this name in reasons of moves, e.g. " of 12".
    """
    moves: list[GoTo | ChangeDrives] = []
    for leg in route:
        if leg.drives != drives:
            drives = leg.drives
            why = f"joints {' and '.join(map(str, drives))} reach {goal}"
            moves.append(ChangeDrives(drives=drives, why=why))
        moves += [
            straight_move(q_rad, drives, f"to {goal}{of}", leg.trace_rad)
            for q_rad in leg.waypoints_rad
        ]
    return moves


def straight_move(
    q_rad: FloatArray, drives: tuple[int, ...], why: str, trace_rad: FloatArray | None = None
) -> GoTo:
    """Return a straight move of the joints `drives` to their angles in the pose `q_rad` (n,)."""
    targets_rad = {j: float(q_rad[j - 1]) for j in drives}
    return GoTo(targets_rad=targets_rad, why=why, trace_rad=trace_rad)
