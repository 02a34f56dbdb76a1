"""What a procedure holds by policy, and what it had better hold: said among checks. Knows no session."""

from __future__ import annotations

from collections.abc import Mapping

from fixtures.base import CheckKind, Fixture, SetupCheck, Severity
from operator_app.config.procedure import Procedure
from operator_app.units.figure import MOUNTED_LENGTH, NOMINAL_OFFSET
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import DhEntry


def held_checks(procedure: Procedure) -> tuple[SetupCheck, ...]:
    """One remark for each free entry of the arm that stays as its file has it, and why."""
    stacked = procedure.arm.table.stacked()
    checks = []
    for name, why in procedure.held.items():
        entry = DhEntry.parse(name)
        value = float(stacked[entry.kind, entry.row - 1])
        shown = (NOMINAL_OFFSET if entry.kind.is_angle else MOUNTED_LENGTH)(value).with_unit
        checks.append(
            SetupCheck(
                kind=CheckKind.FIXED,
                entry=name,
                severity=Severity.OK,
                text=f"{name} is held at {shown}, as the arm's file has it: {why}",
            )
        )
    return tuple(checks)


def holds_for(arm: ArmModel, fixture: Fixture) -> Mapping[str, str]:
    """Which free entries of an arm a fixture cannot show, each with the reason: for a new procedure."""
    return {
        check.entry or f"theta_off_{check.joint}": check.text
        for check in fixture.setup_checks(arm, arm.home_rad)
        if check.kind in (CheckKind.HIDDEN, CheckKind.IMMOBILE)
    }
