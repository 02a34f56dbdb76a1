"""The way to the box of the procedure from elsewhere: only when the operator agrees, slowly, and once.

Inside its box a drive goes anywhere by itself: that is what the procedure says of it. From outside,
the way leads through places nobody has spoken for. Knows no screen; asks nobody itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from hardware.arm import Arm, MoveResult
from operator_app.errors import GuardError
from operator_app.planning.exploration import Box
from operator_app.units.figure import REACH

AT_THE_EDGE_RAD = float(np.deg2rad(5.0))
"""As near to its box as this the arm counts as in it: where it closes need not be where home was stated."""

SLOWLY_RAD_PER_S = float(np.deg2rad(5.0))
"""A person beside the arm sees in time where it goes."""


class Homing(Protocol):
    """What of a session it takes."""

    arm: Arm

    def box(self) -> Box:
        """Where the joints in position mode may be taken."""
        ...

    def go_to(
        self, targets_rad: Mapping[int, float], *, speed_rad_per_s: float | None = None
    ) -> MoveResult:
        """Move the joints in position mode."""
        ...

    def settle(self) -> bool:
        """Wait until the arm has come to rest."""
        ...

    def record(self, name: str, data: Mapping[str, object]) -> None:
        """Keep an event."""
        ...


def away_from_box(session: Homing) -> str:
    """Say which drive joints stand outside their box; empty when none does."""
    box, here = session.box(), session.arm.snapshot().positions_rad
    beyond = box.beyond_rad(here)
    return ", ".join(
        f"joint {j} stands at {REACH(float(here[j - 1])).with_unit}, outside "
        f"{REACH(float(low)).shown} to {REACH(float(high)).with_unit}"
        for j, low, high, by in zip(box.joints, box.lower_rad, box.upper_rad, beyond, strict=True)
        if by > AT_THE_EDGE_RAD
    )


def require_in_box(session: Homing) -> None:
    """Refuse to move by itself an arm that stands where the procedure does not expect it."""
    away = away_from_box(session)
    if away:
        raise GuardError(
            f"the arm is not where this procedure may move it: {away}",
            "bring it there by hand while its drives are off, or agree that it goes by itself, slowly "
            "and straight (--go-home; in the terminal app: Go home)",
        )


def go_home(session: Homing) -> str:
    """Take the drive joints straight and slowly to their home, and say what was done.

    What ends the move ends it for good: the arm holds there, and nothing is tried a second time.
    """
    box = session.box()
    targets = dict(zip(box.joints, box.centre_rad.tolist(), strict=True))
    moved = session.go_to(targets, speed_rad_per_s=SLOWLY_RAD_PER_S)
    session.settle()
    q = session.arm.snapshot().positions_rad
    session.record(
        "went_home", {"joints": list(box.joints), "q_rad": q.tolist(), "stopped": moved.reason}
    )
    if not moved.reached:
        raise GuardError(
            f"the arm was stopped on its way home: {moved.reason}",
            "it holds where it is; look at what is in the way, and bring it home by hand while its "
            "drives are off",
        )
    return "Home: " + ", ".join(
        f"joint {j} at {REACH(float(q[j - 1])).with_unit}" for j in box.joints
    )
