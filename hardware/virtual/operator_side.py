"""Description of faults on the operator's side, which the virtual controller cannot inject."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from hardware.virtual.fault_messages import ArmReaction, FaultDescription

OPERATOR_SIDE: Mapping[str, FaultDescription] = MappingProxyType(
    {
        # tests/system/test_after_a_fault.py, test_a_freeze_of_0_3_s_costs_nothing
        "frozen for 0.3 s": FaultDescription(
            broken="the operator's program stands still, shorter than the drives wait for its heartbeat (0.5 s)",
            goes_on=True,
            remedy="Nothing.",
        ),
        # tests/system/test_after_a_fault.py, test_after_a_freeze_the_same_command_goes_on
        "frozen for longer": FaultDescription(
            broken="the operator's program stands still for longer than that",
            says=("operator's heartbeat lost",),
            remedy="Go on as the last line says: `sarcal run --resume` resets and compares the arm first.",
            arm=ArmReaction.HOLDS,
        ),
        # tests/system/test_kills.py and tests/oracles/killing.py
        "killed": FaultDescription(
            broken="the operator's program, or its computer, dies",
            says=("--resume",),
            remedy="Start it again with `--resume latest`: every accepted pose is on disk.",
            arm=ArmReaction.HOLDS,
        ),
        # tests/operator_app/session/test_journal.py
        "disk full": FaultDescription(
            broken="the journal cannot be written",
            says=("cannot write",),
            remedy="Make room, then go on: a pose that was not written was not accepted.",
        ),
        # tests/system/test_fault_campaign.py, a wall clock that is set back and forth
        "clock set back": FaultDescription(
            broken="somebody sets the computer's clock",
            goes_on=True,
            remedy="Nothing: poses count in the order in which they were taken.",
        ),
        # tests/system/test_busy_bus.py, tests/benchmarks/busy_bus.py
        "busy computer": FaultDescription(
            broken="other programs take the processor",
            says=("operator's heartbeat lost",),
            goes_on=True,
            remedy="End them, or give `sarcal` real-time priority.",
            arm=ArmReaction.HOLDS,
        ),
        # tests/contracts/arm/test_contract.py, two operators exclude each other;
        # tests/hardware/control/canopen_arm/test_watching.py
        "second operator": FaultDescription(
            broken="another program wants to command the arm",
            says=("in control", "Somebody else commands this arm"),
            remedy="End one of the two.",
        ),
    }
)
