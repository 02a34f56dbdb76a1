"""What a procedure holds by policy, said among the checks of its fixture. Knows no session."""

from __future__ import annotations

from fixtures.base import SetupCheck, Severity
from operator_app.config.procedure import Procedure
from operator_app.units.figure import MOUNTED_LENGTH, NOMINAL_OFFSET
from solver.chain.parameters import DhEntry

HELD = "HELD_"
"""What the codes of these remarks begin with."""


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
                code=f"{HELD}{name}",
                severity=Severity.OK,
                text=f"{name} is held at {shown}, as the arm's file has it: {why}",
            )
        )
    return tuple(checks)
