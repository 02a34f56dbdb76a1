"""Parameters that a procedure fixes at their nominal value, as set-up checks."""

from __future__ import annotations

from collections.abc import Mapping

from fixtures.base import CheckKind, Fixture, SetupCheck, Severity
from operator_app.config.procedure import Procedure
from operator_app.units.figure import MOUNTED_LENGTH, NOMINAL_OFFSET
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import DhEntry


def fixed_parameter_checks(procedure: Procedure) -> tuple[SetupCheck, ...]:
    """Return a check for each fixed entry of the arm, with the reason."""
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
                text=f"{name} is fixed at {shown}, its value in the arm file: {why}",
            )
        )
    return tuple(checks)


def entries_to_fix(arm: ArmModel, fixture: Fixture) -> Mapping[str, str]:
    """Return the free entries of an arm that a fixture cannot identify, with the reason: for a new procedure."""
    return {
        check.entry or f"theta_off_{check.joint}": check.text
        for check in fixture.setup_checks(arm, arm.home_rad)
        if check.kind in (CheckKind.HIDDEN, CheckKind.IMMOBILE)
    }
