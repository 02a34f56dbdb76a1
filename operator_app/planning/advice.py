"""Search for hinge placements that make parameters more precise, from nominal or identified geometry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from fixtures.advice import RankedPlacement, search_placements
from fixtures.base import Fixture
from fixtures.hinge import Hinge
from operator_app.errors import SessionError
from solver.chain.arm_model import ArmModel
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhEntry

QUICK_TRIES = 8
"""Number of placements tried for a hint."""
WORTHWHILE = 0.9
"""Largest relative uncertainty at which a placement is worth remounting: 10 % less."""


def at_values(arm: ArmModel, hinge: Hinge, values: Mapping[str, float]) -> tuple[ArmModel, Hinge]:
    """Return arm and hinge with identified values (rad, m, by name) in place of nominal ones."""
    own = {f.name.removesuffix("_rad").removesuffix("_m"): f.name for f in fields(Hinge)}
    last = arm.joint_count
    placed: dict[str, Any] = {}
    stacked = arm.table.stacked()
    for name, value in values.items():
        key = name.removesuffix(f"_{last}") + "_n" if name.endswith(f"_{last}") else name
        if key in own:
            placed[own[key]] = value
        else:
            entry = DhEntry.parse(name)
            stacked[entry.kind, entry.row - 1] = value
    return replace(arm, table=DhTable.from_stacked(stacked)), replace(hinge, **placed)


def advise(
    arm: ArmModel,
    fixture: Fixture,
    *,
    values: Mapping[str, float] | None = None,
    parameters: tuple[str, ...] = (),
    unsensed_joints: tuple[int, ...] = (),
    poses: int = 12,
    tries: int = 24,
    best: int = 3,
) -> tuple[RankedPlacement, ...]:
    """Rank hinge placements around the present one, by all parameters or by those named.

    Raises
    ------
    SessionError
        The fixture is no hinge, or the loop does not close near the arm's home.
    """
    if not isinstance(fixture, Hinge):
        raise SessionError(
            f"placements are compared for a hinge, and this is a {fixture.kind} fixture",
            "use a hinge fixture",
        )
    arm, hinge = at_values(arm, fixture, values or {})
    try:
        return search_placements(
            arm,
            hinge,
            tries=tries,
            best=best,
            poses=poses,
            parameters=parameters,
            unsensed_joints=unsensed_joints,
        )
    except ValueError as error:
        raise SessionError(
            f"placements cannot be compared: {error}", "check the fixture's measures"
        ) from error


def hint(ranked: tuple[RankedPlacement, ...]) -> str:
    """Return the best placement of a ranking as text, or that none would help."""
    if not ranked or ranked[0].gain > WORTHWHILE:
        return "no hinge placement near this one would help much"
    return f"another placement would help: {ranked[0].text}"
