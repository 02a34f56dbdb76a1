"""`sarcal controller`: the virtual controller as its own process, for another terminal to talk to."""

from __future__ import annotations

import argparse
import sys
import threading
from pathlib import Path

from operator_app.commands.options import bus_options, choices_from, scenario_options
from operator_app.exit_codes import ExitCode, UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--arm", default="sarcos_dextrous", help="arm file or built-in name")
    parser.add_argument(
        "--state",
        type=Path,
        metavar="DIR",
        help="folder that keeps uploaded parameters over a restart (default: in memory)",
    )
    bus_options(parser)
    scenario_options(parser)


def execute(args: argparse.Namespace) -> int:
    """Serve until interrupted."""
    from hardware.buses import bus_settings
    from operator_app.composition import run_controller, scenario_of
    from operator_app.config.arm_file import load_arm
    from operator_app.signals import ending_signals_interrupt

    choices = choices_from(args)
    settings = bus_settings(args.interface, args.channel, args.bitrate)
    if settings.interface == "virtual":
        raise UsageError(
            "a virtual bus ends at this process; use -i loopback (no set-up) or -i socketcan -c vcan0"
        )
    arm = load_arm(args.arm)
    with ending_signals_interrupt(), run_controller(arm, choices, settings, slots=args.state):
        chosen = scenario_of(choices)
        print(
            f"Virtual {arm.name} (scenario {chosen.name}, seed {chosen.seed}) on {settings}. "
            f"In another terminal: sarcal run hinge -i {settings.interface} -c {settings.channel}"
            f"{' --scenario exact' if chosen.name == 'exact' else ''}\nCtrl-C ends it.",
            file=sys.stderr,
            flush=True,
        )
        threading.Event().wait()
    return ExitCode.ACCEPTED
