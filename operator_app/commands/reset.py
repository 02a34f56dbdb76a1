"""`sarcal reset`: clears drive faults and a latched STOP. Enables and moves nothing."""

import argparse
from collections.abc import Collection

from hardware.arm import DriveState
from hardware.canopen.cia402 import POWERED_STATES
from hardware.control.canopen_arm import CanopenArm
from hardware.errors import DriveFault
from operator_app.commands.choices import opening_from
from operator_app.composition import open_arm
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.messages.errors import drive_words, unwatching_words
from operator_app.safe_output import as_json, say


def execute(args: argparse.Namespace) -> int:
    """Connect, list the drive faults, reset them, and list the faults that remain."""
    with open_arm(opening_from(args), record_to=args.record) as rig:
        if rig.simulated:
            raise UsageError(
                "the embedded virtual arm has nothing to reset: it starts with each command; name a bus with -i, "
                "or a session on one"
            )
        if isinstance(rig.arm, CanopenArm):
            rig.arm.take_over()  # the only command that switches off drives that another program left enabled
        identity = rig.arm.connect()
        found = rig.arm.found_powered if isinstance(rig.arm, CanopenArm) else {}
        written = [f"Set up as the bus profile requires: {line}" for line in identity.configured]
        unwatching = unwatching_words(identity)
        for line in (*written, *([f"{unwatching}."] if unwatching else [])):
            say(line, err=args.json)  # stdout is for JSON only
        before = rig.arm.snapshot()
        known = {fault.joint: f"{fault.text} ({fault.code:04X}h)" for fault in before.faults}
        stopped = {DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE, *POWERED_STATES}
        faults = {
            joint.joint: known.get(joint.joint, drive_words(found.get(joint.joint, joint.drive)))
            for joint in before.joints
            if joint.drive in stopped or joint.joint in found
        }
        stays: dict[int, str] = {}
        if faults:
            try:
                rig.arm.reset_stop()
            except DriveFault as fault:
                stays[fault.joint] = faults.get(fault.joint, str(fault))
            after = rig.arm.snapshot()
            stays |= {
                joint.joint: faults.get(joint.joint, drive_words(joint.drive))
                for joint in after.joints
                if joint.drive in stopped and joint.joint not in stays
            }
    cleared = {joint: text for joint, text in faults.items() if joint not in stays}
    report(cleared, stays, switched_off=found, arm_joints=len(before.joints), in_json=args.json)
    return ExitCode.ARM_FAULT if stays else ExitCode.ACCEPTED


def report(
    cleared: dict[int, str],
    stays: dict[int, str],
    *,
    switched_off: Collection[int] = (),
    arm_joints: int,
    in_json: bool,
) -> None:
    """Print which joints' faults were cleared, which drives were switched off, and which faults remain."""
    if in_json:
        facts = {
            "cleared": [{"joint": j, "was": text} for j, text in cleared.items()],
            "left": [{"joint": j, "is": text} for j, text in stays.items()],
        }
        say(as_json(facts))
        return
    for joint, text in cleared.items():
        say(f"Joint {joint}  {text}: {'switched off' if joint in switched_off else 'reset'}")
    if cleared:
        say("The drives are off. Nothing has moved.")
    elif not stays:
        say(
            "No drive has a fault. Connecting has reset the communication of all nodes, as it always does."
        )
    for text in dict.fromkeys(stays.values()):
        joints = [joint for joint, reason in stays.items() if reason == text]
        # A fault of all joints, such as an open stop contact, is reported once for the arm.
        who = "the arm" if len(joints) > 1 and len(joints) == arm_joints else ""
        for name in [who] if who else [f"joint {joint}" for joint in joints]:
            say(
                f"sarcal: {name} still has a fault: {text}. Remove the cause (release the external stop; or "
                "check the sensor and its cable; or find what the joint hit), then reset again.",
                err=True,
            )
