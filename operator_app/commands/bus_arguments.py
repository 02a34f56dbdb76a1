"""Arguments and options of the commands that open a bus."""

import argparse

from operator_app.commands.options import (
    ARM_BUS,
    BUS,
    BUS_WITHOUT_PROFILE,
    SESSION_OR_ARM,
    VIRTUAL_ARM,
    between,
    declaration,
    group,
    option,
    shared,
)

NEW_POSES = 12
"""Number of new poses to capture unless ``--poses`` states it."""
FAULT_HELP = "help"

app = declaration(
    group(
        "terminal app",
        """
        --procedure PROCEDURE  procedure file or built-in name (hinge)
        --poses N  how many poses to capture
        --resume SESSION  go on with a session: folder, name or latest
        --ascii  only ASCII characters
        --plain  numbered prompts instead of the terminal app
        --light  begin with the light theme
        --speed N  let the embedded virtual arm run N times faster than real time (default 1)
        """,
    ),
    shared("--tracker PORT, --sessions DIR, --record"),
    ARM_BUS,
)

arm_check = declaration(
    SESSION_OR_ARM,
    """
    --through  the last stage: look (nothing is enabled), hold (drives on, refusals, STOP), move (each
        joint a little; halted, interrupted and stopped on its way), free (each joint in free mode),
        leave (released and connected again), silence (as if this program died); default silence.
        Every stage after look asks first, joint by joint
    --step DEG  how far each joint is turned (default 1 deg; the tool must be free to move)
    --speed DEG_PER_S  how fast (default 1 deg/s)
    """,
    shared("--record FILE, --json"),
    ARM_BUS,
)


def controller(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal controller`."""
    from hardware.canopen import objects
    from hardware.virtual.fault_messages import FAULTS

    default_s, most_s = objects.HEARTBEAT_TIMEOUT_S, objects.MAX_OPERATOR_TIMEOUT_S
    at_connect = [kind for kind, fault_words in FAULTS.items() if fault_words.at_connect]

    declaration(
        """
        --arm ARM  arm file or built-in name (default sarcos_dextrous)
        --fixture FIXTURE  fixture file or built-in name (default hinge)
        --procedure P  arm and fixture of this procedure, instead of --arm and --fixture; the arm starts
            at its home_deg
        --placement K  number of the placement (default 1): from 2 on the fixture is elsewhere within
            its file's tolerance, for a session with `run --placements`
        --state DIR  folder that keeps uploaded parameters over a restart (default: in memory)
        --tracker-port N  port of this machine for the simulated tracker of an open arm (a fixture of
            kind measured, such as tracker): default 7327, 0 is any free port
        """,
        option(
            "--heartbeat-timeout S",
            "time in s without the operator's heartbeat after which the drives trip (1016h): default "
            f"{default_s:g}, at most {most_s:g}; a busy machine may need more than the default. `sarcal "
            f"arm-check` accepts at most {objects.ADVISED_OPERATOR_TIMEOUT_S:g}",
            type=between(0.1, most_s, "s"),
        ),
        group(
            "injected faults, to see how they appear to an operator",
            option(
                "--fault KIND",
                "inject a fault; may be repeated. `--fault help` lists for each what fails, what the operator "
                f"sees and what to do. One of: {', '.join(FAULTS)}",
                type=str,
                action="append",
                default=[],
                choices=(*FAULTS, FAULT_HELP),
            ),
            f"""
            --fault-joint J  joint of a fault that concerns one joint (default 3)
            --fault-sync N  SYNC at which the fault occurs, counted from the start; 0: before the
                connection (default 0 for {", ".join(at_connect)}, which appear at the connection; 1000
                for others: after 10 s in real time)
            """,
        ),
        BUS_WITHOUT_PROFILE,
        shared("--record FILE"),
        VIRTUAL_ARM,
    )(parser)


export = declaration(
    shared("session SESSION"),
    """
    --format  yaml: the parameters file, for the controller; json: everything; csv: one row per
        parameter; urdf: the arm itself, for simulators and planners; mat: for MATLAB (default: by the
        ending of -o, else yaml)
    -o --output FILE  file to write (default: in the session folder, parameters.yaml, result.json,
        parameters.csv, arm.urdf or result.mat; - is stdout)
    --into FILE  your own URDF, xacro with literal numbers or UR default_kinematics.yaml, to be copied
        with only the joint origins changed (default -o: FILE_calibrated in the session folder)
    --upload  upload the parameters to the controller and read them back
    """,
    shared("--force REASON, --json, --estimator, --unsensed JOINTS, --sessions DIR, --record"),
    ARM_BUS,
)

monitor = declaration(
    "--seconds S  how long to watch (default: until Ctrl-C)", BUS, shared("--record FILE, --json")
)

probe = declaration(
    """
    --draft FILE  write a bus profile of the drives that are found, for --profile
    --configure  with --draft: a profile that has PDOs written into the drives at every connection
        (pdo_maps: configured), for drives whose present PDOs do not suffice; probe itself writes
        nothing
    """,
    BUS,
    shared("--record FILE, --json"),
)

reset = declaration(SESSION_OR_ARM, shared("--record FILE, --json"), ARM_BUS)

run = declaration(
    option("procedure?", "procedure file or built-in name (hinge)", default="hinge"),
    """
    --poses N  how many poses to capture
    --placements N  mount the fixture N times and capture --poses in each placement: the arm's offsets
        are shared, the fixture parameters differ. Between two placements the program asks you to
        remount the fixture
    --resume SESSION  go on with a session: its folder, its name or latest
    --no-upload  write the parameters but do not upload them
    """,
    shared(
        "--record, --force REASON, --go-home, --plan, --estimator, --unsensed JOINTS, "
        "--length-tolerance MM, --tracker PORT, --sessions DIR, --json"
    ),
    ARM_BUS,
)

verify = declaration(
    shared("session SESSION"),
    """
    csv? POSES.csv  new poses; without this file the arm captures them
    --open-loop  compare with an instrument's endpoints of the open arm: shows which offsets and
        lengths disagree. POSES.csv has the endpoints (x_m,y_m,z_m[,rx_deg,ry_deg,rz_deg]); without
        POSES.csv the arm, out of its fixture, captures the poses of --procedure in a new session
    """,
    option(
        "--procedure P",
        "with --open-loop: procedure of the open arm (default open_loop)",
        default="open_loop",
    ),
    shared("--tracker PORT"),
    f"""
    --instrument FIXTURE  uncertainty of the instrument of POSES.csv: a fixture file of kind measured
        (default tracker: 0.05 mm, 0.02 deg)
    --poses N  how many new poses to capture (default {NEW_POSES})
    """,
    shared("--go-home, --sessions DIR, --record, --json"),
    ARM_BUS,
)
