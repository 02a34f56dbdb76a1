"""`sarcal controller`: the virtual controller as a separate process."""

import argparse
import textwrap
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from can import CanError

from hardware.buses.python_can import BusSettings, bus_settings
from hardware.buses.shared_bus import record_bus
from hardware.canopen.objects import HEARTBEAT_TIMEOUT_S
from hardware.errors import BusError
from hardware.timing import real_time_priority
from hardware.virtual.fault_messages import FAULTS
from hardware.virtual.faults import ScriptedFault
from hardware.virtual.tracker import HOST, TRACKER_PORT, SimulatedTracker, serve_tracker
from operator_app.commands.bus_arguments import FAULT_HELP
from operator_app.commands.choices import choices_from
from operator_app.composition import print_recording_problem
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.procedure_file import load_procedure
from operator_app.config.resources import builtin_names
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.safe_output import say
from operator_app.virtual_arms import run_controller

_AT_SYNC = 1000


def execute(args: argparse.Namespace) -> int:
    """Run the controller until interrupted."""
    if FAULT_HELP in args.fault:
        say(fault_table())
        return ExitCode.ACCEPTED
    choices = choices_from(args, journal=False)
    settings = bus_settings(args.interface, args.channel, args.bitrate)
    if settings.interface == "virtual":
        raise UsageError(
            "a virtual bus has no other process; use -i loopback (no set-up) or -i socketcan -c vcan0"
        )
    new = ""
    if args.procedure is None:
        names = args.arm or "sarcos_dextrous", args.fixture or "hinge"
        arm, fixture = load_arm(names[0]), load_fixture(names[1])
        run, new = procedure_of(*names, fixture_kind=fixture.kind)
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
        chosen = choices.virtual_arm
        again = f", placement {args.placement}" if args.placement > 1 else ""
        say(
            f"Virtual {arm.name} in {fixture.name} (scenario {chosen.name}, seed {chosen.seed}{again}) on "
            f"{settings}. In another terminal: sarcal run {run} -i {settings.interface} -c {settings.channel}"
            f"{' --scenario exact' if chosen.name == 'exact' else ''}{tracker}{new}\n"
            + "".join(
                f"{f'At SYNC {fault.at_sync}' if fault.at_sync else 'From the beginning'}: "
                f"{FAULTS[fault.kind].broken} (joint {fault.joint}).\n"
                for fault in script
            )
            + "Ctrl-C ends it.",
            err=True,
        )
        while (failure := controller.failure) is None:
            time.sleep(0.2)
    if isinstance(failure, (CanError, OSError)):
        raise BusError(
            f"The bus can no longer be used: {failure}. Check adapter and interface, and start again."
        ) from failure
    raise failure


def procedure_of(arm: str, fixture: str, *, fixture_kind: str) -> tuple[str, str]:
    """Return the arguments of `sarcal run`, and how to make the procedure file ("" if a built-in procedure fits)."""
    if arm != "sarcos_dextrous" or fixture not in builtin_names("fixture"):
        made_by = f"sarcal new procedure --arm {arm} --fixture {fixture}"
        return "PROCEDURE", f" (to make PROCEDURE: {made_by})"
    return "open_loop --go-home" if fixture_kind == "measured" else fixture_kind, ""


def script_of(args: argparse.Namespace, joints: int) -> list[ScriptedFault]:
    """Return the faults named in the options, in order; raises UsageError for an invalid joint."""
    if not 1 <= args.fault_joint <= joints:
        raise UsageError(f"--fault-joint: joints are 1 to {joints}")
    usual = {kind: 0 if FAULTS[kind].at_connect else _AT_SYNC for kind in args.fault}
    return [
        ScriptedFault(
            kind=kind,
            joint=args.fault_joint,
            at_sync=usual[kind] if args.fault_sync is None else args.fault_sync,
        )
        for kind in args.fault
    ]


@contextmanager
def _recorded(settings: BusSettings, path: Path | None) -> Iterator[None]:
    if path is None:
        yield
        return
    problem_of: Callable[[], str | None] | None = None
    try:
        with record_bus(settings, path) as problem_of:
            yield
    finally:
        if problem_of is not None:
            print_recording_problem(path, problem_of())


@contextmanager
def _tracker(tracker: SimulatedTracker | None, port: int | None) -> Iterator[str]:
    """Serve `tracker` while the context is open; yield the option ``--tracker`` for `sarcal run`, or "" for None."""
    if tracker is None:
        if port is not None:
            raise UsageError("--tracker-port: this fixture has no tracker; use --fixture tracker")
        yield ""
        return
    with serve_tracker(tracker.answer, TRACKER_PORT if port is None else port) as port_served:
        yield f" --tracker tcp:{HOST}:{port_served}"


def fault_table() -> str:
    """Return the table of faults: what is broken, what the operator sees, what the arm does, what is kept, remedy."""
    rows = []
    for kind, fault in FAULTS.items():
        facts = {
            "broken": fault.broken,
            "you see": fault.symptom(),
            "arm": fault.does(),
            "kept": fault.kept,
            "do": fault.remedy,
        }
        lines = (
            textwrap.fill(
                f"  {head:<8}{text}", 100, subsequent_indent=" " * 10, break_on_hyphens=False
            )
            for head, text in facts.items()
        )
        rows.append("\n".join((kind, *lines)))
    return "\n\n".join(rows)
