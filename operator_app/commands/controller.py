"""`sarcal controller`: the virtual controller as a separate process."""

from __future__ import annotations

import argparse
import textwrap
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from hardware.canopen.objects import (
    ADVISED_OPERATOR_TIMEOUT_S,
    HEARTBEAT_TIMEOUT_S,
    MAX_OPERATOR_TIMEOUT_S,
)
from hardware.virtual.fault_messages import FAULTS
from operator_app.commands.options import (
    a_path,
    bus_options,
    choices_from,
    option,
    options,
    placement_count,
    scenario_options,
)
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.safe_output import say

if TYPE_CHECKING:
    from hardware.buses.python_can import BusSettings
    from hardware.virtual.faults import ScriptedFault
    from hardware.virtual.tracker import SimulatedTracker

_HELP = "help"
_AT_CONNECT = tuple(kind for kind, words in FAULTS.items() if words.at_connect)
_AT_SYNC = 1000
_LOOK_S = 0.2
"""Interval of checks that the controller is running."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    option(parser, "--arm ARM", "arm file or built-in name (default sarcos_dextrous)")
    option(parser, "--fixture FIXTURE", "fixture file or built-in name (default hinge)")
    option(
        parser,
        "--procedure P",
        "arm and fixture of this procedure, instead of --arm and --fixture; the arm starts at its home_deg",
    )
    option(
        parser,
        "--placement K",
        "number of the placement (default 1): from 2 on the fixture is elsewhere within its file's "
        "tolerance, for a session with `run --placements`",
        type=placement_count,
        default=1,
    )
    option(
        parser,
        "--state DIR",
        "folder that keeps uploaded parameters over a restart (default: in memory)",
        type=a_path,
    )
    option(
        parser,
        "--tracker-port N",
        "where the simulated tracker of an open arm (a fixture of kind measured, such as tracker) "
        "listens on this machine; default 7327, 0 takes any that is free",
        type=int,
    )
    option(
        parser,
        "--heartbeat-timeout S",
        "time in s without the operator's heartbeat after which the drives trip (1016h): default "
        f"{HEARTBEAT_TIMEOUT_S:g}, at most {MAX_OPERATOR_TIMEOUT_S:g}; for a machine that both programs share with "
        f"others. `sarcal arm-check` passes no more than {ADVISED_OPERATOR_TIMEOUT_S:g}",
        type=_patience_s,
    )
    faults = parser.add_argument_group("injected faults, to see how they appear to an operator")
    faults.add_argument(
        "--fault",
        action="append",
        default=[],
        choices=(*FAULTS, _HELP),
        metavar="KIND",
        help="inject a fault; may be repeated. `--fault help` lists for each what fails, what the operator "
        f"sees and what to do. One of: {', '.join(FAULTS)}",
    )
    option(
        faults,
        "--fault-joint J",
        "joint of a fault that concerns one joint (default 3)",
        type=int,
        default=3,
    )
    option(
        faults,
        "--fault-sync N",
        "SYNC at which the fault occurs, counted from the start; 0: before the connection (default 0 for "
        f"{', '.join(_AT_CONNECT)}, which appear at the connection; 1000 for others: after 10 s in real time)",
        type=int,
    )
    bus_options(parser, profile=False)
    options(parser, "--record FILE")
    scenario_options(parser)


def execute(args: argparse.Namespace) -> int:
    """Run until interrupted."""
    from hardware.buses.python_can import bus_settings
    from hardware.timing import real_time_priority
    from operator_app.config.arm_file import load_arm
    from operator_app.config.fixture_file import load_fixture
    from operator_app.config.procedure_file import load_procedure
    from operator_app.virtual_arms import run_controller, virtual_arm

    if _HELP in args.fault:
        say(fault_table())
        return ExitCode.ACCEPTED
    choices = choices_from(args, journal=False)
    settings = bus_settings(args.interface, args.channel, args.bitrate)
    if settings.interface == "virtual":
        raise UsageError(
            "a virtual bus has no other process; use -i loopback (no set-up) or -i socketcan -c vcan0"
        )
    if args.procedure is None:
        arm = load_arm(args.arm or "sarcos_dextrous")
        fixture = load_fixture(args.fixture or "hinge")
        run = "open_loop --go-home" if fixture.kind == "measured" else fixture.kind
    elif args.arm or args.fixture:
        raise UsageError("--procedure names arm and fixture: leave --arm and --fixture out")
    else:
        procedure = load_procedure(args.procedure)
        arm, fixture, run = procedure.arm, procedure.fixture, args.procedure
    script = script_of(args, arm.joint_count)
    with (
        real_time_priority(),
        _recorded(settings, args.record),
        run_controller(
            arm,
            choices,
            settings,
            fixture=fixture,
            placement=args.placement,
            slots=args.state,
            script=script,
            heartbeat_timeout_s=args.heartbeat_timeout or HEARTBEAT_TIMEOUT_S,
        ) as controller,
        _tracker(controller.tracker, args.tracker_port) as tracker,
    ):
        chosen = virtual_arm(arm, fixture, choices, args.placement)
        again = f", placement {args.placement}" if args.placement > 1 else ""
        say(
            f"Virtual {arm.name} in {fixture.name} (scenario {chosen.name}, seed {chosen.seed}{again}) on "
            f"{settings}. "
            f"In another terminal: sarcal run {run} "
            f"-i {settings.interface} -c {settings.channel}"
            f"{' --scenario exact' if chosen.name == 'exact' else ''}{tracker}\n"
            + "".join(
                f"{f'At SYNC {fault.at_sync}' if fault.at_sync else 'From the beginning'}: "
                f"{FAULTS[kind].broken} (joint {args.fault_joint}).\n"
                for kind, fault in zip(args.fault, script, strict=True)
            )
            + "Ctrl-C ends it.",
            err=True,
        )
        while controller.failure is None:
            time.sleep(_LOOK_S)
    raise _controller_error(controller.failure)


def _patience_s(text: str) -> float:
    try:
        found = float(text)
    except ValueError:
        found = 0.0
    if not 0.1 <= found <= MAX_OPERATOR_TIMEOUT_S:
        raise argparse.ArgumentTypeError(
            f"{text} is not a time from 0.1 to {MAX_OPERATOR_TIMEOUT_S:g} s"
        )
    return found


def script_of(args: argparse.Namespace, joints: int) -> list[ScriptedFault]:
    """Return the faults named in the options, in order; raises UsageError for an invalid joint or SYNC."""
    from hardware.virtual.faults import scripted

    if not 1 <= args.fault_joint <= joints:
        raise UsageError(f"--fault-joint: joints are 1 to {joints}")
    if args.fault_sync is not None and args.fault_sync < 0:
        raise UsageError("--fault-sync: SYNCs count from 1; 0 is before the connection")
    usual = {kind: 0 if kind in _AT_CONNECT else _AT_SYNC for kind in args.fault}
    return [
        scripted(
            kind,
            joint=args.fault_joint,
            at_sync=usual[kind] if args.fault_sync is None else args.fault_sync,
        )
        for kind in args.fault
    ]


def _controller_error(failure: Exception) -> Exception:
    """Return the exception to raise if the controller has ended by itself."""
    from can import CanError

    from hardware.errors import BusError

    if isinstance(failure, (CanError, OSError)):
        return BusError(
            f"The bus can no longer be used: {failure}. Check adapter and interface, and start again."
        )
    return failure


@contextmanager
def _recorded(settings: BusSettings, path: Path | None) -> Iterator[None]:
    """Record the bus, if `path` is given: from the first boot-up to the last frame."""
    from hardware.buses.shared_bus import record_bus

    if path is None:
        yield
        return
    ended: Callable[[], str | None] | None = None
    try:
        with record_bus(settings, path) as ended:
            yield
    finally:
        if ended is not None and (why := ended()):
            say(
                f"sarcal: the recording of the bus, {path}, has ended early: {why}. "
                "Free some space, or record to another disk.",
                err=True,
            )


@contextmanager
def _tracker(tracker: SimulatedTracker | None, port: int | None) -> Iterator[str]:
    """Serve the tracker of an open arm; yields the option for the command that connects to it."""
    from hardware.virtual.tracker import HOST, TRACKER_PORT, serve_tracker

    if tracker is None:
        if port is not None:
            raise UsageError("--tracker-port: this fixture has no tracker; use --fixture tracker")
        yield ""
        return
    if port is not None and not 0 <= port < 65536:
        raise UsageError("--tracker-port: ports are 1 to 65535, 0 takes any that is free")
    with serve_tracker(tracker.answer, TRACKER_PORT if port is None else port) as found:
        yield f" --tracker tcp:{HOST}:{found}"


def fault_table() -> str:
    """Return the table of faults: what is broken, what the operator sees, reaction of the arm, remedy."""
    rows = [
        f"{kind}\n"
        + "\n".join(
            textwrap.fill(
                text,
                width=100,
                initial_indent=f"  {head:<8}",
                subsequent_indent=" " * 10,
                break_on_hyphens=False,
            )
            for head, text in (
                ("broken", words.broken),
                ("you see", words.seen()),
                ("arm", words.does()),
                ("kept", words.kept),
                ("do", words.remedy),
            )
        )
        for kind, words in FAULTS.items()
    ]
    return "\n\n".join(rows)
