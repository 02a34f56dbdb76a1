"""`sarcal monitor`: shows the traffic of a bus. Sends nothing."""

import argparse
import sys
import time
from collections.abc import Iterable
from datetime import UTC, datetime

from hardware.buses.python_can import open_bus
from hardware.buses.shared_bus import SharedBus
from hardware.commissioning.bus_monitor import BusMonitor
from operator_app.commands.choices import bus_of_others
from operator_app.composition import print_recording_problem
from operator_app.config.procedure import DEFAULT_PROFILE
from operator_app.config.profile_file import load_profile
from operator_app.exit_codes import ExitCode
from operator_app.safe_output import as_json, say

BUS_POLL_S = 0.1


def execute(args: argparse.Namespace) -> int:
    """Watch the bus, print events and, at the end, a summary."""
    settings = bus_of_others(args)
    monitor = BusMonitor(load_profile(args.profile or DEFAULT_PROFILE))
    wire = SharedBus(open_bus(settings), record_to=args.record)
    begun = time.monotonic()
    try:
        say(f"Watching {settings}; Ctrl-C ends it.", err=True)
        while args.seconds is None or time.monotonic() < begun + args.seconds:
            message = wire.receive(BUS_POLL_S)
            now = time.monotonic()
            if message is not None:
                _say(args, monitor.take_in(message.arbitration_id, bytes(message.data), now))
            _say(args, monitor.time_passes(now))
    except KeyboardInterrupt:
        if args.seconds is not None:
            raise
    finally:
        wire.close()
        print_recording_problem(args.record, wire.recording_failure)
    summary = monitor.summary()
    if args.json:
        say(as_json(summary))
    else:
        say(
            f"{summary['frames']} frames, {summary['syncs']} SYNCs in "
            f"{time.monotonic() - begun:.1f} s; nothing was sent."
        )
    return ExitCode.ACCEPTED


def _say(args: argparse.Namespace, sentences: Iterable[str]) -> None:
    for sentence in sentences:
        time_utc = f"{datetime.now(UTC):%H:%M:%S}"
        say(f"{time_utc}  {sentence}", err=args.json, streaming=True)
        (sys.stderr if args.json else sys.stdout).flush()
