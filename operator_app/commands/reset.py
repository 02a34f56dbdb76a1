"""`sarcal reset`: clears tripped drives and a STOP, in words. Enables nothing and moves nothing."""

from __future__ import annotations

import argparse
import json

from operator_app.commands.options import (
    arm_options,
    bus_options,
    json_option,
    opening_from,
    record_option,
    scenario_options,
)
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.words_out import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    arm_options(parser)
    bus_options(parser)
    record_option(parser)
    scenario_options(parser)
    json_option(parser)


def execute(args: argparse.Namespace) -> int:
    """Connect, say what has tripped, reset it, say what stays."""
    from hardware.arm import DriveState
    from hardware.errors import DriveFault
    from operator_app.composition import open_arm
    from operator_app.session.wording import drive_words
    from operator_app.signals import ending_signals_interrupt

    with ending_signals_interrupt(), open_arm(opening_from(args), record_to=args.record) as rig:
        if rig.simulated:
            raise UsageError(
                "the embedded virtual arm begins anew with every program: there is nothing to reset; "
                "name a bus with -i, or a session on one"
            )
        rig.arm.connect()
        before = rig.arm.snapshot()
        known = {fault.joint: f"{fault.text} ({fault.code:04X}h)" for fault in before.faults}
        stopped = {DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE, DriveState.QUICK_STOP_ACTIVE}
        found = {
            joint.joint: known.get(joint.joint, drive_words(joint.drive))
            for joint in before.joints
            if joint.drive in stopped
        }
        stays: dict[int, str] = {}
        if found:
            try:
                rig.arm.reset_stop()
            except DriveFault as fault:
                stays[fault.joint] = str(fault)
            after = rig.arm.snapshot()
            stays |= {
                joint.joint: found.get(joint.joint, drive_words(joint.drive))
                for joint in after.joints
                if joint.drive in stopped and joint.joint not in stays
            }
    cleared = {joint: text for joint, text in found.items() if joint not in stays}
    _report(args, cleared, {joint: found.get(joint, text) for joint, text in stays.items()})
    return ExitCode.ARM_FAULT if stays else ExitCode.ACCEPTED


def _report(args: argparse.Namespace, cleared: dict[int, str], stays: dict[int, str]) -> None:
    if args.json:
        facts = {
            "cleared": [{"joint": j, "was": text} for j, text in cleared.items()],
            "left": [{"joint": j, "is": text} for j, text in stays.items()],
        }
        say(json.dumps(facts, indent=2))
        return
    for joint, text in cleared.items():
        say(f"Joint {joint}  {text}: reset")
    if cleared:
        say("The drives are off. Nothing has moved, and nothing moves before it is told to.")
    elif not stays:
        say("No drive has tripped: nothing was reset.")
    for joint, text in stays.items():
        say(
            f"sarcal: joint {joint} stays tripped: {text}. Remove the cause (release the external stop, "
            "look at the sensor and at what the joint met), then reset again.",
            err=True,
        )
