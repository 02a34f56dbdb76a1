"""Arms of other installed packages: entry points of group ``sarcal.arm``.

With an `ArmOffer` named OFFER and the lines::

    [project.entry-points."sarcal.arm"]
    my_arm = "my_package:OFFER"

a package offers an arm that is selected with ``-i my_arm -c CHANNEL``. If the name is also an interface of python-can,
that interface is used.
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path

import can

from hardware.arm import ArmInterface
from hardware.arm_description import ArmDescription
from hardware.errors import BusError

GROUP = "sarcal.arm"


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmOrder:
    """Request for an arm.

    Attributes
    ----------
    description
        Joints of the arm file in order, with names, ranges (rad), speeds (rad/s) and sensors.
    channel
        Text of ``-c``, in a form that the package defines; empty if absent.
    bitrate
        Bit rate of ``-b``; None if absent.
    record_to
        File of ``--record``, to which the bus is recorded; None if absent.
    """

    description: ArmDescription
    channel: str = ""
    bitrate: int | None = None
    record_to: Path | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmOffer:
    """Object to which an entry point of group ``sarcal.arm`` refers.

    Attributes
    ----------
    make
        Function that makes the arm, not yet connected.
    says
        One-line description for people.
    keeps_parameters
        Whether a controller stores a parameter document; if not, nothing is uploaded.
    records
        Whether `ArmOrder.record_to` is used.
    """

    make: Callable[[ArmOrder], ArmInterface]
    says: str
    keeps_parameters: bool = False
    records: bool = False


def offered_names() -> tuple[str, ...]:
    """Return the names of the arms that installed packages offer."""
    return tuple(sorted({point.name for point in entry_points(group=GROUP)}))


def offer(name: str) -> ArmOffer | None:
    """Return the arm offered as `name`; None if there is none. `BusError` if two packages offer it or loading fails."""
    if name in can.VALID_INTERFACES:
        return None
    points = {
        (p.dist.name if p.dist is not None else p.module, p.value): p
        for p in entry_points(group=GROUP, name=name)
    }
    if not points:
        return None
    if len(points) > 1:
        packages = " and ".join(sorted({package for package, _ in points}))
        raise BusError(f"Two packages offer an arm called {name}: {packages}. Uninstall one.")
    [((package, value), point)] = points.items()
    try:
        loaded = point.load()
    except Exception as error:  # a package may raise anything on import
        raise BusError(
            f"The arm {name!r} of the package {package} cannot be loaded ({value}): "
            f"{type(error).__name__}: {error}. Install what that package needs, or report this to its author."
        ) from error
    if not isinstance(loaded, ArmOffer):
        raise BusError(
            f"The arm {name!r} of the package {package} ({value}) is a {type(loaded).__name__}, not a "
            "sarcal.arms.ArmOffer. Report this to the author of the package."
        )
    return loaded
