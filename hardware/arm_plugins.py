"""Arms that other installed packages offer: entry points of group ``sarcal.arm``, found by name. Opens none.

A package that has::

    [project.entry-points."sarcal.arm"]
    my_arm = "my_package:OFFER"

with an `ArmOffer` of that name makes ``-i my_arm -c CHANNEL`` an arm like any other. A name that python-can
has for an interface of its own goes on meaning that bus.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import can

from hardware.arm import Arm
from hardware.arm_description import ArmDescription
from hardware.errors import BusError

GROUP = "sarcal.arm"


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmOrder:
    """Which arm is wanted; what a maker does not need it leaves alone.

    Attributes
    ----------
    description
        The arm of the arm file: joints in order, with names, ranges (rad), speeds (rad/s) and sensors.
    channel
        What the operator named with ``-c``; empty where nothing was named. Means what the maker says.
    bitrate
        ``-b``, None where it was not given.
    record_to
        Where ``--record`` wants what is said on the wire; None for nowhere.
    """

    description: ArmDescription
    channel: str = ""
    bitrate: int | None = None
    record_to: Path | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmOffer:
    """What an entry point of group ``sarcal.arm`` names.

    Attributes
    ----------
    make
        Makes the arm, unconnected; `Arm.connect` does the rest.
    says
        What it is, in a line, for people.
    keeps_parameters
        Whether there is a controller that takes and keeps a parameter document. Without one a session
        writes its files and uploads nothing.
    records
        Whether `ArmOrder.record_to` is heeded.
    """

    make: Callable[[ArmOrder], Arm]
    says: str
    keeps_parameters: bool = False
    records: bool = False


def offered_names() -> tuple[str, ...]:
    """Names of the arms that installed packages offer."""
    return tuple(sorted({point.name for point in entry_points(group=GROUP)}))


def offer(name: str) -> ArmOffer | None:
    """Return what installed packages offer by this name; None where nobody does.

    Raises
    ------
    BusError
        Two packages offer it, or it cannot be loaded.
    """
    if name in can.VALID_INTERFACES:
        return None
    points = {(_package(p), p.value): p for p in entry_points(group=GROUP, name=name)}
    if not points:
        return None
    packages = sorted({package for package, _ in points})
    if len(points) > 1:
        raise BusError(
            f"Two packages offer an arm called {name}: {' and '.join(packages)}. Uninstall one."
        )
    (point,) = points.values()
    return _loaded(point)


def _loaded(point: EntryPoint) -> ArmOffer:
    try:
        found = point.load()
    except Exception as error:  # whatever a package does when it is imported
        raise BusError(
            f"The arm {point.name} of the package {_package(point)} cannot be loaded ({point.value}): "
            f"{type(error).__name__}: {error}. Install what that package needs, or tell its author."
        ) from error
    if not isinstance(found, ArmOffer):
        raise BusError(
            f"The arm {point.name} of the package {_package(point)} ({point.value}) is a "
            f"{type(found).__name__} and no sarcal.arms.ArmOffer. Tell its author."
        )
    return found


def _package(point: EntryPoint) -> str:
    return point.dist.name if point.dist is not None else point.module
