"""Refusals before a fit: unidentifiable directions, and placements without unique parameters."""

from __future__ import annotations

from collections.abc import Collection

from fixtures.base import EndpointConstraint, SetupCheck, Severity
from fixtures.errors import FixtureError
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector
from solver.diagnostics.identifiability import Identifiability
from solver.diagnostics.limits import FEW_DOF
from solver.errors import UnidentifiableError
from solver.loops.closure import ClosureModel


class FixtureRefusedError(FixtureError):
    """A set-up check refuses this placement; `checks` say why and what to remount."""

    code = "PARALLEL_AXES"

    def __init__(self, checks: tuple[SetupCheck, ...]) -> None:
        self.checks = checks
        super().__init__("; ".join(f"{c.text}: {c.remedy}" for c in checks))


def require_identifiable(
    seen: Identifiability, model: ClosureModel, poses: int, *, known: Collection[str] = ()
) -> None:
    """Refuse unidentifiable directions of `model`, unless the arm's file states an uncertainty (`known`).

    Raises
    ------
    UnidentifiableError
        Some direction is unidentifiable.
    """
    blind = tuple(d for d in seen.directions if not set(d.parameters) & set(known))
    if blind:
        if poses * model.equations_per_pose - len(model.parameters) < FEW_DOF:
            raise UnidentifiableError(
                blind,
                code="TOO_FEW_POSES",
                note=f"{poses} poses are few: take at least 20",
            )
        raise UnidentifiableError(blind)


def refuse_placement(fixture: EndpointConstraint, arm: ArmModel, model: ClosureModel) -> None:
    """Refuse a nominal placement in which parameters have no unique values (Hayati)."""
    part, *_ = model.parts()[0]
    checks = fixture.placement_checks(arm, part, nominal_vector(part.parameters))
    refused = tuple(c for c in checks if c.severity is Severity.REFUSED)
    if refused and model.parameters:
        raise FixtureRefusedError(refused)


def placement_checks(
    fixture: EndpointConstraint, arm: ArmModel, model: ClosureModel, x: FloatArray
) -> tuple[SetupCheck, ...]:
    """Check the geometry of every placement at the identified parameters `x` of `model`."""
    found: dict[tuple[str, str], SetupCheck] = {}
    for part, columns, _ in model.parts():
        for check in fixture.placement_checks(arm, part, x[columns]):
            found.setdefault((check.code, check.text), check)
    return tuple(found.values())
