"""`sarcal reset`: clears tripped drives and a STOP, in words. Enables nothing and moves nothing."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from operator_app.commands.options import (
    bus_options,
    choices_from,
    json_option,
    scenario_options,
    sessions_option,
)
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.words_out import say

if TYPE_CHECKING:
    from operator_app.session.opening import Opening


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "session",
        nargs="?",
        metavar="SESSION",
        help="a session on the arm to be reset: its arm file and its bus (folder, name or latest)",
    )
    parser.add_argument(
        "--arm",
        default="sarcos_dextrous",
        help="arm file or built-in name, where no session is named (default sarcos_dextrous)",
    )
    sessions_option(parser)
    bus_options(parser)
    scenario_options(parser)
    json_option(parser)


def execute(args: argparse.Namespace) -> int:
    """Connect, say what has tripped, reset it, say what stays."""
    from hardware.arm import DriveState
    from hardware.errors import DriveFault
    from operator_app.composition import open_arm
    from operator_app.session.wording import drive_words
    from operator_app.signals import ending_signals_interrupt

    with ending_signals_interrupt(), open_arm(_opening(args)) as rig:
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


def _opening(args: argparse.Namespace) -> Opening:
    """What to connect to: the arm of a session, or the one the options name."""
    from dataclasses import replace

    from operator_app.config.arm_file import load_arm
    from operator_app.config.procedure import DEFAULT_PROFILE
    from operator_app.config.profile_file import load_profile
    from operator_app.session.opening import begin, resume

    choices = choices_from(args)
    if args.session is not None:
        return resume(args.session, choices, root=args.sessions)
    arm = load_arm(args.arm)
    profile = load_profile(args.profile or DEFAULT_PROFILE, joints=arm.joint_count)
    opening = begin("hinge", replace(choices, profile=None), root=args.sessions)
    return replace(opening, procedure=replace(opening.procedure, arm=arm, profile=profile))
