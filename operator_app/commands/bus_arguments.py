"""Arguments and options of the commands that open a bus."""

from __future__ import annotations

import argparse

from operator_app.commands.options import (
    a_path,
    arm_bus_options,
    arm_options,
    bus_options,
    option,
    options,
    placement_count,
    pose_count,
    scenario_options,
)

STAGES = ("look", "hold", "move", "free", "leave", "silence")
"""Names of `hardware.commissioning.stages.Stage`; copied, so that --help does not load the bus."""
FORMATS = ("yaml", "json", "csv", "urdf", "mat")
NEW_POSES = 12
"""Number of new poses to capture unless ``--poses`` states it."""
FAULT_HELP = "help"


def app(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal`."""
    group = parser.add_argument_group("terminal app")
    option(
        group, "--procedure PROCEDURE", "procedure file or built-in name (hinge)", default="hinge"
    )
    option(group, "--poses N", "how many poses to capture", type=pose_count)
    option(group, "--resume SESSION", "go on with a session: folder, name or latest")
    option(group, "--ascii", "only ASCII characters")
    option(group, "--plain", "numbered prompts instead of the terminal app")
    option(group, "--light", "begin with the light theme")
    option(
        group,
        "--speed N",
        "let the embedded virtual arm run N times faster than real time (default 1)",
        type=float,
        default=1.0,
    )
    options(parser, "--tracker PORT, --sessions DIR, --record")
    arm_bus_options(parser)


def arm_check(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal arm-check`."""
    arm_options(parser)
    option(
        parser,
        "--through",
        "the last stage: look (nothing is enabled), hold (drives on, refusals, STOP), move (each "
        "joint a little; halted, interrupted and stopped on its way), free (each joint in free mode), leave (released "
        "and connected again), silence (as if this program died); default silence. Every stage after look asks "
        "first, joint by joint",
        choices=STAGES,
        default=STAGES[-1],
    )
    option(
        parser,
        "--step DEG",
        "how far each joint is turned (default 1 deg; the tool must be free to move)",
        type=float,
        default=1.0,
    )
    option(parser, "--speed DEG_PER_S", "how fast (default 1 deg/s)", type=float, default=1.0)
    options(parser, "--record FILE, --json")
    arm_bus_options(parser)


def controller(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal controller`."""
    from hardware.canopen.objects import (
        ADVISED_OPERATOR_TIMEOUT_S,
        HEARTBEAT_TIMEOUT_S,
        MAX_OPERATOR_TIMEOUT_S,
    )
    from hardware.virtual.fault_messages import FAULTS

    at_connect = [kind for kind, fault_words in FAULTS.items() if fault_words.at_connect]

    def patience_s(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = 0.0
        if not 0.1 <= value <= MAX_OPERATOR_TIMEOUT_S:
            raise argparse.ArgumentTypeError(
                f"{text} is not a time from 0.1 to {MAX_OPERATOR_TIMEOUT_S:g} s"
            )
        return value

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
        type=patience_s,
    )
    faults = parser.add_argument_group("injected faults, to see how they appear to an operator")
    faults.add_argument(
        "--fault",
        action="append",
        default=[],
        choices=(*FAULTS, FAULT_HELP),
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
        f"{', '.join(at_connect)}, which appear at the connection; 1000 for others: after 10 s in real time)",
        type=int,
    )
    bus_options(parser, profile=False)
    options(parser, "--record FILE")
    scenario_options(parser)


def export(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal export`."""
    options(parser, "session SESSION")
    option(
        parser,
        "--format",
        "yaml: the parameters file, for the controller; json: everything; csv: one row per parameter; "
        "urdf: the arm's own side, for simulators and planners; mat: for MATLAB (default: by the ending of -o, "
        "else yaml)",
        choices=FORMATS,
    )
    option(
        parser,
        "-o --output FILE",
        "file to write (default: in the session folder, parameters.yaml, result.json, parameters.csv, "
        "arm.urdf or result.mat; - is stdout)",
        type=a_path,
    )
    option(
        parser,
        "--into FILE",
        "your own URDF, xacro with literal numbers or UR default_kinematics.yaml, to be copied with only the "
        "joint origins changed (default -o: FILE_calibrated in the session folder)",
        type=a_path,
    )
    option(parser, "--upload", "upload them to the controller and read them back")
    options(
        parser,
        "--force REASON, --json, --estimator, --unsensed JOINTS, --sessions DIR, --record",
    )
    arm_bus_options(parser)


def monitor(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal monitor`."""
    option(parser, "--seconds S", "how long to watch (default: until Ctrl-C)", type=float)
    bus_options(parser)
    options(parser, "--record FILE, --json")


def probe(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal probe`."""
    option(
        parser,
        "--draft FILE",
        "write a bus profile of the drives that are found, for --profile",
        type=a_path,
    )
    option(
        parser,
        "--configure",
        "with --draft: a profile that has PDOs written into the drives at every connection "
        "(pdo_maps: configured), for drives whose present PDOs do not suffice; probe itself writes nothing",
    )
    bus_options(parser)
    options(parser, "--record FILE, --json")


def reset(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal reset`."""
    arm_options(parser)
    options(parser, "--record FILE, --json")
    arm_bus_options(parser)


def run(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal run`."""
    option(parser, "procedure?", "procedure file or built-in name (hinge)", default="hinge")
    option(parser, "--poses N", "how many poses to capture", type=pose_count)
    option(
        parser,
        "--placements N",
        "mount the fixture N times and capture --poses in each placement: the arm's offsets are shared, the "
        "fixture parameters differ. Between two placements the program asks you to remount it",
        type=placement_count,
    )
    option(parser, "--resume SESSION", "go on with a session: its folder, its name or latest")
    option(parser, "--no-upload", "write the parameters but do not upload them")
    options(
        parser,
        "--record, --force REASON, --go-home, --plan, --estimator, --unsensed JOINTS, "
        "--length-tolerance MM, --tracker PORT, --sessions DIR, --json",
    )
    arm_bus_options(parser)


def verify(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal verify`."""
    options(parser, "session SESSION")
    option(
        parser,
        "csv? POSES.csv",
        "new poses; without it the arm captures new ones at other positions",
    )
    option(
        parser,
        "--open-loop",
        "with endpoints of the open arm measured by an instrument: shows which offsets and lengths "
        "disagree. From POSES.csv (x_m,y_m,z_m[,rx_deg,ry_deg,rz_deg]); without it the arm, out of its "
        "fixture, captures the poses of --procedure, in a session of their own",
    )
    option(
        parser,
        "--procedure P",
        "with --open-loop: procedure of the open arm (default open_loop)",
        default="open_loop",
    )
    options(parser, "--tracker PORT")
    option(
        parser,
        "--instrument FIXTURE",
        "uncertainty of the instrument of POSES.csv: a fixture file of kind measured (default tracker: "
        "0.05 mm, 0.02 deg)",
        default="tracker",
    )
    option(
        parser, "--poses N", f"how many new poses to capture (default {NEW_POSES})", type=pose_count
    )
    options(parser, "--go-home, --sessions DIR, --record, --json")
    arm_bus_options(parser)
