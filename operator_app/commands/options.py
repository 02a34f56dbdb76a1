"""Options shared by several commands; how options are declared, and how their values are read."""

import argparse
import math
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from textwrap import dedent
from typing import Any

from hardware.virtual import DEFAULT_SCENARIO, SCENARIOS
from operator_app.config.errors import shortened
from operator_app.exit_codes import UsageError
from operator_app.units import MOST_WHOLE

MOST_POSES = 100_000
"""Largest number of poses in a poses file or a procedure."""
STAGES = ("look", "hold", "move", "free", "leave", "silence")
"""Names of `hardware.commissioning.bench_check.Stage`; copied, so that --help does not load the bus."""
FORMATS = ("yaml", "json", "csv", "urdf", "mat")


def whole(least: int, most: int = MOST_WHOLE) -> Callable[[str], int]:
    """Return a parser of whole numbers from `least` to `most`."""

    def parse(text: str) -> int:
        value = int(text) if re.fullmatch(r"\d{1,18}", text) else -1
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"{text} is not a whole number from {least} to {most}")
        return value

    return parse


def between(least: float, most: float, unit: str = "") -> Callable[[str], float]:
    """Return a parser of numbers from `least` to `most`, except 0. Error messages state these limits in `unit`."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = 0.0
        if value == 0.0 or not least <= value <= most:
            limits = f"between {least:g} and {most:g} {unit}".rstrip()
            raise argparse.ArgumentTypeError(f"{shortened(text)} is not a number {limits}")
        return value

    return parse


def length_tolerance_m(text: str) -> float:
    """Parse a standard deviation in mm and return it in m."""
    return between(0.0, 100.0, "mm")(text) / 1e3


def numbers(text: str) -> tuple[int, ...]:
    """Parse text such as ``6,7`` into ascending numbers of joints or placements."""
    if re.fullmatch(r"\d+(,\d+)*", text.replace(" ", "")) and "0" in re.split("[ ,]+", text):
        raise argparse.ArgumentTypeError(f"{text!r}: joints and placements are numbered from 1")
    if not re.fullmatch(r"[1-9]\d{0,8}(,[1-9]\d{0,8})*", text.replace(" ", "")):
        raise argparse.ArgumentTypeError(
            f"{shortened(text)!r}: write numbers of at most 9 digits, separated by commas, e.g. 6,7"
        )
    return tuple(sorted({int(part) for part in text.replace(" ", "").split(",")}))


def a_name(text: str) -> str:
    """Return `text`, the value of an option; raises ArgumentTypeError if it is empty."""
    if not text.strip():
        raise argparse.ArgumentTypeError(
            "the value is empty: give a value, or leave the option out; an unset shell variable is empty"
        )
    return text


def a_path(text: str) -> Path:
    """Parse the path of a file or folder to write; expands ``~``."""
    # `Path.expanduser` also expands ./~name.
    path = os.path.expanduser(a_name(text))  # noqa: PTH111
    if path.startswith("~"):
        raise argparse.ArgumentTypeError(
            f"{text}: there is no such home folder; for a folder of that name write ./{text}"
        )
    return Path(path)


ARGUMENTS: Mapping[str, Mapping[str, Any]] = {
    "--estimator": {"choices": ("implicit", "paper")},
    "--plan": {"choices": ("explore", "planned")},
    "--scenario": {"choices": SCENARIOS},
    "--through": {"choices": STAGES, "default": STAGES[-1]},
    "--format": {"choices": FORMATS},
    "--kind": {"choices": ("hinge", "ball")},
    "--from NAME": {"dest": "packaged"},
    "--upload": {"dest": "upload_now"},
    "--no-upload": {"dest": "upload", "action": "store_const", "const": False},
    "--poses N": {"type": whole(1, MOST_POSES)},
    "--unsensed JOINTS": {"type": numbers, "dest": "unsensed_joints"},
    "--placements NUMBERS": {"type": numbers},
    "--placements N": {"type": whole(1)},
    "--placement K": {"type": whole(1, 9999), "default": 1},
    "--sessions DIR": {"type": a_path, "default": Path("sessions")},
    "--state DIR": {"type": a_path},
    "--record FILE": {"type": a_path},
    "--draft FILE": {"type": a_path},
    "--into FILE": {"type": a_path},
    "--files FOLDER": {"type": a_path},
    "--plots FOLDER": {"type": a_path},
    "-o --output FILE": {"type": a_path},
    "-o --output DIR": {"type": a_path, "default": Path()},
    "-b --bitrate BITRATE": {"type": int},
    "--seed SEED": {"type": whole(0)},
    "--tries N": {"type": whole(1)},
    "--tracker-port N": {"type": whole(0, 65535)},
    "--fault-joint J": {"type": int, "default": 3},
    "--fault-sync N": {"type": whole(0)},
    "--speed N": {"type": between(0.01, 50.0), "default": 1.0},
    "--speed DEG_PER_S": {"type": between(0.05, 10.0, "deg/s"), "default": 1.0},
    "--step DEG": {"type": between(0.05, 10.0, "deg"), "default": 1.0},
    "--seconds S": {"type": between(0.0, 1e7, "s")},
    "--dwell-s S": {"type": between(0.01, 3600.0, "s")},
    "--spread-deg DEG": {"type": between(1e-4, 5.0, "deg")},
    "--length-tolerance MM": {"type": length_tolerance_m, "dest": "length_tolerance_m"},
    "--tolerance-mm MM": {"type": float},
    "--tolerance-deg DEG": {"type": float},
    "--level P": {"type": between(0.0, math.nextafter(1.0, 0.0)), "default": 0.01},
    "--every DAYS": {"type": between(0.0, 36500.0, "days")},
    "--instrument FIXTURE": {"default": "tracker"},
}
"""Further arguments to argparse for some options, by usage."""

Declaration = Callable[[argparse._ActionsContainer], object]  # noqa: SLF001 - no public name
"""Function that adds arguments and options to a parser."""


def option(usage: str, description: str, **more: Any) -> Declaration:
    """Return the declaration of an option (`usage` such as ``-o --output FILE``) or an argument (``poses+ FILE``).

    An option without a metavar (``FILE``) and without `choices` is a switch. All others take a value, by default a text
    that must not be empty. `more`: arguments of argparse's `add_argument`; they override those in `ARGUMENTS`.
    """
    more = {**ARGUMENTS.get(usage, {}), **more}
    names = usage.split()
    if not usage.startswith("-"):
        metavar, name = names[1:], names[0].rstrip("?*+")
        more = {"type": a_name, "nargs": names[0][len(name) :] or None} | more
        names, more = [name], more | ({"metavar": metavar[0]} if metavar else {})
    elif not names[-1].startswith("-"):
        more = {"type": a_name, "metavar": names.pop()} | more
    elif "choices" not in more:
        more = {"action": "store_true"} | more
    return lambda parser: parser.add_argument(*names, help=description, **more)


def descriptions(text: str) -> dict[str, str]:
    """Return a mapping from the usage of each option in `text`, such as ``--seed SEED``, to the option's description.

    In `text`, each option begins with the usage and two spaces. Further lines of the description are indented.
    """
    options = (entry.split("  ", 1) for entry in re.split(r"\n(?! )", dedent(text).strip()))
    return {usage: " ".join(description.split()) for usage, description in options}


def declaration(*parts: str | Declaration) -> Declaration:
    """Return a function that adds all `parts` to a parser. A string lists options in the form of `descriptions`."""

    def declare(parser: argparse._ActionsContainer) -> None:
        for part in parts:
            if isinstance(part, str):
                part = declaration(*(option(*item) for item in descriptions(part).items()))  # noqa: PLW2901
            part(parser)

    return declare


def group(title: str, *parts: str | Declaration) -> Declaration:
    """Return a function that adds `parts`, as `declaration` does, under a title in the help."""
    return lambda parser: declaration(*parts)(parser.add_argument_group(title))


def one_of(*parts: str | Declaration) -> Declaration:
    """Return the declaration of options that exclude each other."""
    return lambda parser: declaration(*parts)(parser.add_mutually_exclusive_group())


# -- options that several commands have ------------------------------------------------------------

SHARED = descriptions(
    """
    session SESSION  session folder, its name or latest
    --json  print one JSON object on stdout
    --estimator  implicit weights every joint by its sensor (default); paper is the published
        unweighted least squares
    --unsensed JOINTS  joints whose readings are not to be used, e.g. 6,7
    --length-tolerance MM  standard deviation of the link lengths, e.g. 1.5; default: as in the arm file
    --force REASON  export a calibration even if it is not accepted; the reason is kept in the
        journal and in the parameters
    --go-home  agree that an arm outside the procedure's box of drive angles goes home by itself,
        straight and at 5 deg/s; without this option such an arm is not moved. Stand clear
    --plan  how poses are chosen: explore visits a box of drive angles in a fixed order; planned
        explores first, calibrates, and captures the 12 (or --poses) most informative poses
    --tracker PORT  port of the instrument that measures an open arm: tcp:HOST:PORT, file:PATH (a
        growing CSV file) or stdin; one JSON object per line, with x_m, y_m, z_m and the orientation
        of the target. Default: as in the procedure; an embedded virtual arm has its own tracker
    --sessions DIR  folder that holds the session folders (default ./sessions)
    --record  record the bus to bus.blf in the session folder (bus-2.blf beside an earlier one)
    --record FILE  record the bus (.blf, .asc, .log)
    """
)
"""Description of arguments and options that several commands have, by usage."""


def shared(usages: str) -> Declaration:
    """Return the declaration of shared options; `usages` are keys of `SHARED`, separated by commas."""
    return declaration(*(option(usage, SHARED[usage]) for usage in usages.split(", ")))


_BUS_TITLE = "bus (python-can's names; also CAN_INTERFACE and can.conf)"
_BUS = """
    -i --interface INTERFACE  virtual (default, embedded controller), loopback, socketcan, ...
    -c --channel CHANNEL  e.g. can0, vcan0; for loopback any name
    -b --bitrate BITRATE  bit/s, e.g. 1000000
    """
_PROFILE = """
    --profile P  set-up of the arm's nodes: bus profile file or built-in name (default sarcos, or that
        of the procedure); sarcal probe --draft writes one
    """
BUS, BUS_WITHOUT_PROFILE = group(_BUS_TITLE, _BUS, _PROFILE), group(_BUS_TITLE, _BUS)
VIRTUAL_ARM = group(
    "virtual arm",
    f"""
    --scenario  what is wrong with the virtual arm: exact (nothing), datasheet (sensors at their
        specification), as_reported (the paper's three error sources), wild (another arm and hinge
        for every seed); default {DEFAULT_SCENARIO}
    --seed SEED  seed of the virtual arm's errors (default 0)
    """,
)
ARM_BUS = declaration(BUS, VIRTUAL_ARM)
"""Options that select the bus of a real or virtual arm."""
ARM_AND_FIXTURE = declaration(
    option("--arm ARM", "arm file or built-in name", default="sarcos_dextrous"),
    option("--fixture FIXTURE", "fixture file or built-in name", default="hinge"),
    """
    --drop-unidentifiable  fix unidentifiable parameters at their nominal values, instead of refusing
    """,
)
"""Options that select arm and fixture, for a command that reads a file of poses."""
SESSION_OR_ARM = declaration(
    "session? SESSION  session (folder, name or latest) whose arm file and bus are used",
    option(
        "--arm ARM",
        "arm file or built-in name, where no session is named (default sarcos_dextrous)",
        default="sarcos_dextrous",
    ),
    shared("--sessions DIR"),
)
"""Options that select the arm of a session or an arm file, for a command that uses no poses."""

# -- values ----------------------------------------------------------------------------------------


def make_folder(option: str, folder: Path) -> None:
    """Create the folder that `option` names, unless it exists; raises UsageError if it cannot be created."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(
            f"{option}: {folder} cannot be created ({error.strerror}): name another folder"
        ) from error


def unsensed_joints(args: argparse.Namespace, joint_count: int) -> tuple[int, ...] | None:
    """Return the joints that ``--unsensed`` lists, None without it; raises UsageError for a joint the arm lacks."""
    joints: tuple[int, ...] | None = args.unsensed_joints
    wrong = [j for j in joints or () if j > joint_count]
    if wrong:
        raise UsageError(f"--unsensed: there is no joint {wrong[0]}; the arm has {joint_count}")
    return joints
