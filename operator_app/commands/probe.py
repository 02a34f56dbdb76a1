"""`sarcal probe`: which nodes are on a bus, and whether they are set up as this program drives them."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict

from operator_app.commands.options import bus_options, json_option
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.words_out import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    bus_options(parser)
    json_option(parser)


def execute(args: argparse.Namespace) -> int:
    """Look, and report; exit 3 where nobody answers or something differs."""
    from hardware.buses import bus_settings
    from hardware.probing import probe
    from operator_app.config.procedure import DEFAULT_PROFILE
    from operator_app.config.profile_file import load_profile
    from operator_app.report.text import aligned

    settings = bus_settings(args.interface, args.channel, args.bitrate)
    if settings.interface == "virtual":
        raise UsageError(
            "a virtual bus ends at this process: nobody else is on it; name a bus with -i and -c"
        )
    found = probe(settings, load_profile(args.profile or DEFAULT_PROFILE))
    problems = [problem for node in found.nodes for problem in node.problems]
    fine = bool(found.nodes) and not problems
    if args.json:
        say(json.dumps(asdict(found), indent=2))
        return ExitCode.ACCEPTED if fine else ExitCode.ARM_FAULT
    if found.busy:
        heard = ", ".join(map(str, found.heard)) or "none"
        say(
            f"sarcal: {found.busy}: nobody was asked anything. Heartbeats of nodes: {heard}.",
            err=True,
        )
        return ExitCode.ARM_FAULT
    if not found.nodes:
        say(
            f"sarcal: no node answers on {settings}. Check power, cable and bitrate.",
            err=True,
        )
        return ExitCode.ARM_FAULT
    rows = [["node", "device", "type (1000h)", "serial", "6064h (counts)", "state"]]
    for node in found.nodes:
        rows.append(
            [
                str(node.node),
                node.device_name or "-",
                f"{node.device_type:08X}h",
                "-" if node.serial_number is None else str(node.serial_number),
                "-" if node.position_counts is None else str(node.position_counts),
                "differs" if node.problems else "as expected",
            ]
        )
    say(aligned(rows))
    for problem in problems:
        say(problem)
    say("Nothing was enabled and nothing has moved.")
    return ExitCode.ACCEPTED if fine else ExitCode.ARM_FAULT
