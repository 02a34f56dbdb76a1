"""Options that several commands share, declared once. Knows argparse and nothing else."""

from __future__ import annotations

import argparse
from pathlib import Path

SCENARIOS = ("exact", "datasheet", "as_reported", "wild")
DEFAULT_SCENARIO = "datasheet"


def json_option(parser: argparse.ArgumentParser) -> None:
    """``--json``: one JSON object on stdout."""
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")


def estimator_options(parser: argparse.ArgumentParser) -> None:
    """``--estimator`` and ``--unsensed``."""
    parser.add_argument(
        "--estimator",
        choices=("implicit", "paper"),
        help="implicit weights every joint by its sensor (default); paper is the published "
        "unweighted least squares",
    )
    parser.add_argument(
        "--unsensed",
        metavar="JOINTS",
        default="",
        help="joints whose readings are not to be used, e.g. 6,7",
    )


def bus_options(parser: argparse.ArgumentParser) -> None:
    """python-can's own names: ``-i -c -b``."""
    group = parser.add_argument_group("bus (python-can's names; also CAN_INTERFACE and can.conf)")
    group.add_argument(
        "-i", "--interface", help="virtual (default, embedded controller), loopback, socketcan, ..."
    )
    group.add_argument("-c", "--channel", help="e.g. can0, vcan0; for loopback any name")
    group.add_argument("-b", "--bitrate", type=int, help="bit/s, e.g. 1000000")


def scenario_options(parser: argparse.ArgumentParser, default: str | None) -> None:
    """``--scenario`` and ``--seed`` of the virtual arm."""
    group = parser.add_argument_group("virtual arm")
    group.add_argument(
        "--scenario",
        choices=SCENARIOS,
        default=default,
        help="what is wrong with the virtual arm: exact (nothing), datasheet (sensors at their "
        "specification), as_reported (the paper's three error sources), wild (another arm and "
        f"hinge for every seed); default {DEFAULT_SCENARIO}",
    )
    group.add_argument("--seed", type=int, default=0, help="of the virtual arm (default 0)")


def sessions_option(parser: argparse.ArgumentParser) -> None:
    """``--sessions``: where session folders are kept."""
    parser.add_argument(
        "--sessions",
        type=Path,
        default=Path("sessions"),
        metavar="DIR",
        help="folder that holds the session folders (default ./sessions)",
    )
