"""Reads the options that several commands share: bus, session, recording."""

from __future__ import annotations

import argparse
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING

from fixtures.measured import Measured
from operator_app.config.arm_file import load_arm
from operator_app.config.procedure import DEFAULT_PROFILE, Procedure
from operator_app.config.profile_file import load_profile
from operator_app.config.user_settings import usual_bus, valid_settings
from operator_app.exit_codes import UsageError
from operator_app.safe_output import say
from operator_app.session.workflow.opening import Choices, Opening, begin, resume

if TYPE_CHECKING:
    from hardware.buses.python_can import BusSettings


def bus_of_others(args: argparse.Namespace) -> BusSettings:
    """Return the settings of a bus shared with other processes (``-i -c -b``); raises UsageError for a virtual bus."""
    from hardware.buses.python_can import bus_settings

    settings = bus_settings(
        args.interface, args.channel, args.bitrate, otherwise=usual_bus(args.interface)
    )
    if settings.interface == "virtual":
        raise UsageError("a virtual bus has no other process; name a bus with -i and -c")
    return settings


def opening_from(args: argparse.Namespace) -> Opening:
    """Return the `Opening` of the session named in the options or, if none is named, for the arm file ``--arm``."""
    # The commands that call this function write no journal and do not need the operator's name.
    choices = choices_from(args, journal=False)
    if args.session is not None:
        return resume(args.session, choices, root=args.sessions)
    arm = load_arm(args.arm)
    profile = load_profile(args.profile or DEFAULT_PROFILE, joints=arm.joint_count)
    opening = begin("hinge", replace(choices, profile=None), root=args.sessions)
    return replace(opening, procedure=replace(opening.procedure, arm=arm, profile=profile))


def recording(args: argparse.Namespace, opening: Opening) -> Path | None:
    """Return the file in the session folder to which ``--record`` records the bus; None without that option."""
    return opening.folder / "bus.blf" if args.record else None


def choices_from(args: argparse.Namespace, *, journal: bool = True) -> Choices:
    """Return the choices made by these options; if `journal`, with the operator's name from the user settings."""
    if args.channel is not None and not (args.channel.isprintable() and len(args.channel) <= 255):
        raise UsageError("--channel: a bus name has at most 255 printable characters, e.g. can0")
    operator = None
    if journal:
        settings, wrong = valid_settings()
        operator = settings.operator
        if wrong:
            say(f"sarcal: {wrong}.", err=True)
    # The destinations of these options have the names of the choices.
    names = {field.name for field in fields(Choices)}
    chosen = {name: value for name, value in vars(args).items() if name in names}
    return Choices(**chosen, operator=operator)


def require_instrument(args: argparse.Namespace, procedure: Procedure) -> None:
    """Raise UsageError if ``--tracker`` is given for a fixture that is not an instrument."""
    if args.tracker is not None and not isinstance(procedure.fixture.fixture, Measured):
        raise UsageError(
            f"leave --tracker out: procedure {procedure.name} has a {procedure.fixture.kind} fixture, not an instrument"
        )
