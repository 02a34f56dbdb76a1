"""`sarcal arm-check`: tests an arm on the bench, in a safe order, before its first use."""

import argparse
import math
import sys
from dataclasses import asdict

from hardware.arm import PowerReporting
from hardware.commissioning.bench_check import Bench, CheckFinding, Stage, check
from operator_app.commands.choices import opening_from
from operator_app.composition import describe, open_arm
from operator_app.errors import DrivesNotOffError
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.safe_output import as_json, sanitized, say
from operator_app.signals import ending_signals_ignored, press_ctrl_c

RESULT_MARKS = {True: "ok", False: "FAILED", None: "-"}


def execute(args: argparse.Namespace) -> int:
    """Run the tests and print the findings; exit 3 if a test failed or the drives do not hold the arm at the end."""
    findings: list[CheckFinding] = []
    with open_arm(opening_from(args), record_to=args.record) as rig:
        if rig.simulated:
            raise UsageError(
                "the embedded virtual arm is part of this program: run `sarcal controller -i loopback` in another "
                "terminal, or name the bus of a real arm with -i"
            )
        arm = rig.arm
        try:
            bench = Bench(
                arm=arm,
                description=describe(rig.opening.procedure.arm),
                ask=_ask,
                step_rad=math.radians(args.step),
                speed_rad_per_s=math.radians(args.speed),
                interrupt=press_ctrl_c,
            )
            for finding in check(bench, last=Stage(args.through)):
                findings.append(finding)
                who = "" if finding.joint is None else f"joint {finding.joint}"
                line = (
                    f"{RESULT_MARKS[finding.passed]:<7} {finding.stage.value:<8} {who:<9} "
                    f"{finding.name:<16} {sanitized(finding.text)}"
                )
                say(line, err=args.json, streaming=True)
        finally:
            with ending_signals_ignored():
                held = arm.close()
                powered = arm.left_powered if isinstance(arm, PowerReporting) else ()
    if args.json:
        rows = [{"stage": "", **asdict(f)} | {"stage": f.stage.value} for f in findings]
        say(as_json({"findings": rows, "held": held}))
    if not any(finding.name == "connect" for finding in findings):
        left = "Nothing was enabled: there is no connection to the arm."
    else:
        left = "The arm is held." if held else str(DrivesNotOffError(powered))
    failed = sum(f.passed is False for f in findings)
    passed = sum(f.passed is True for f in findings)
    say(
        f"{passed} passed, {failed} failed, {len(findings) - passed - failed} not tested. "
        f"{left[0].upper()}{left[1:]}",
        err=args.json,
    )
    return ExitCode.ACCEPTED if held and not failed else ExitCode.ARM_FAULT


def _ask(question: str) -> bool:
    say(f"{question} [y/N] ", err=True)
    sys.stderr.flush()
    return sys.stdin.readline().strip().lower() in ("y", "yes")
