"""Settings of a CAN bus and of the arm on it, and functions that open the bus through python-can.

Settings use python-can's names and sources, in order of precedence: command-line options (``-i/--interface -c/--channel
-b/--bitrate``), the environment (``CAN_INTERFACE``, ``CAN_CHANNEL``, ``CAN_BITRATE``, ``CAN_CONFIG``) and ``can.conf``;
by default the interface is ``virtual``. Instead of an interface, the settings may name an arm that another package
provides (`hardware.arm_plugins`). Such an arm has a channel, but no CAN bus.
"""

import errno
import logging
import socket
import time
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from types import MappingProxyType
from typing import Any

import can
from can.interfaces.socketcan import SocketcanBus
from can.util import load_config, load_environment_config, load_file_config

from hardware.arm_description import ArmDescription
from hardware.arm_plugins import offered_names
from hardware.buses.loopback import DEFAULT_CHANNEL, LoopbackBus, enlarge_receive_buffer
from hardware.canopen.bus_profile import BusProfile
from hardware.errors import BusError, BusSettingsError
from hardware.timing import Pace, Timing

# Failures that these libraries log reach the caller as BusError.
for _library in ("can", "canopen"):
    logging.getLogger(_library).addHandler(logging.NullHandler())

DEFAULT_INTERFACE = "virtual"
_OPENED_ONCE = frozenset({"virtual", "slcan", "serial", "robotell", "seeedstudio"})
"""Interfaces of which only one handle is opened. The in-process bus would queue every frame for a second handle too. On
a serial line, opening or closing a second handle closes the first."""
_HOST_STAMPED = frozenset({"socketcan", "loopback", "udp_multicast", "virtual"})
"""Interfaces whose frames this computer stamps on arrival, with its time of day."""
_OWN_CHANNEL = frozenset({"virtual", "loopback"})
_NO_CAN_IN_KERNEL = frozenset({errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT})
_NOT_ALLOWED = frozenset({errno.EPERM, errno.EACCES})
_DRIVER_MISSING = (can.CanInterfaceNotImplementedError, NameError, ImportError, AttributeError)


@dataclass(frozen=True, slots=True, kw_only=True)
class BusSettings:
    """Settings of a bus, under python-can's names."""

    interface: str = DEFAULT_INTERFACE
    """``virtual`` (inside this process), ``loopback`` (between processes of this machine), ``socketcan``, or any other
    interface of python-can."""
    channel: str = DEFAULT_CHANNEL
    """Name of the bus in this interface."""
    bitrate: int | None = None
    """Bit rate, bit/s; None keeps the present one. ``virtual``, ``loopback`` and ``socketcan`` ignore this setting."""
    options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    """Other options from ``can.conf`` or ``CAN_CONFIG``, passed to python-can."""
    named_in: str = field(default="", compare=False)
    """File that names the interface, for error messages; empty if no file does."""

    def __str__(self) -> str:
        return f"{self.interface} {self.channel}"


def known_interfaces() -> tuple[str, ...]:
    """Return the valid names of ``-i``: interfaces of python-can and this project, and arms of installed packages."""
    return tuple(sorted({*can.VALID_INTERFACES, *_OWN_CHANNEL, *offered_names()}))


def bus_settings(
    interface: str | None = None,
    channel: str | None = None,
    bitrate: int | None = None,
    *,
    otherwise: BusSettings | None = None,
) -> BusSettings:
    """Return the settings of a bus, each from the first source that states it: arguments, environment, ``can.conf``.

    If none of these sources names an interface, `otherwise` supplies the interface, and channel and bitrate where no
    source states them. Raises `BusSettingsError` for an unknown interface, invalid bitrate or missing channel.
    """
    stated = {"interface": interface, "channel": channel, "bitrate": bitrate}
    options: dict[str, Any] = {name: value for name, value in stated.items() if value is not None}
    try:
        named = {**load_file_config(), **load_environment_config(), **options}
        chosen_name = named.get("interface") or named.get("bustype")
        if chosen_name is None and otherwise is not None:
            try:
                usual = bus_settings(
                    otherwise.interface,
                    channel or named.get("channel") or otherwise.channel or None,
                    bitrate if "bitrate" in named else otherwise.bitrate,
                )
            except BusSettingsError as error:
                raise BusSettingsError(f"{error}{_named_in(otherwise)}") from error
            return replace(usual, named_in=otherwise.named_in)
        if chosen_name is None:
            options["interface"] = DEFAULT_INTERFACE
        elif chosen_name not in can.VALID_INTERFACES and chosen_name in offered_names():
            rate = named.get("bitrate")
            return BusSettings(
                interface=chosen_name,
                channel=str(named.get("channel", "")),
                bitrate=None if rate is None else int(rate),
            )
        settings: dict[str, Any] = dict(load_config(config=options))
    except can.CanInterfaceNotImplementedError as error:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        arms = ", ".join(offered_names())
        offered = f" Arms of installed packages: {arms}." if arms else ""
        raise BusSettingsError(f"{error}. Use one of: {known}.{offered}") from error
    except (ValueError, TypeError) as error:
        raise BusSettingsError(
            f"The bus settings cannot be read: {error}. Look at can.conf and at the environment "
            "variables that start with CAN_."
        ) from error
    chosen, where = settings.pop("interface"), settings.pop("channel")
    rate = settings.pop("bitrate", None)
    if where is None and chosen not in _OWN_CHANNEL:
        raise BusSettingsError(
            f"No channel is given for interface {chosen}. Name one, for example "
            f"-i {chosen} -c {'can0' if chosen == 'socketcan' else '0'}."
        )
    if rate is not None and not (isinstance(rate, int) and rate > 0):
        raise BusSettingsError(
            f"The bitrate {rate!r} is not a number of bits a second, such as 1000000."
        )
    if where is not None and not str(where).isprintable():
        raise BusSettingsError(
            f"The channel name {str(where)!a} contains characters that cannot be printed. Correct it."
        )
    return BusSettings(
        interface=str(chosen),
        channel=DEFAULT_CHANNEL if where is None else str(where),
        bitrate=rate,
        options=MappingProxyType(settings),
    )


def open_bus(settings: BusSettings, **extra: Any) -> can.BusABC:
    """Open a bus, with `extra` as further options for python-can; raises `BusError` with the remedy."""
    if settings.interface not in can.VALID_INTERFACES and settings.interface in offered_names():
        raise BusError(
            f"{settings.interface} is an arm of an installed package, not a CAN bus. Name an interface of "
            "python-can."
        )
    options = {**settings.options, **extra}
    if settings.bitrate is not None:
        options["bitrate"] = settings.bitrate
    try:
        if settings.interface == "loopback":  # works without installation too
            return LoopbackBus(settings.channel, **options)
        bus = can.Bus(
            interface=settings.interface, channel=settings.channel, ignore_config=True, **options
        )
    except Exception as error:  # missing drivers raise anything
        raise BusError(describe_failure(settings, error) + _named_in(settings)) from error
    if isinstance(bus, SocketcanBus):
        enlarge_receive_buffer(bus.socket)
        pending = bus.socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if pending:  # a device that is down can be opened
            bus.shutdown()
            down = describe_failure(settings, OSError(pending, ""))
            raise BusError(down + _named_in(settings))
    return bus


def open_sender(settings: BusSettings) -> can.BusABC:
    """Open a second handle, for STOP, that only sends; raises `BusError` if that is not possible."""
    if settings.interface in _OPENED_ONCE:
        raise BusError(f"The bus {settings} is opened only once.")
    # A filter that matches nothing: standard identifiers end at 7FFh.
    nothing = [{"can_id": 0x1FFFFFFF, "can_mask": 0x1FFFFFFF, "extended": False}]
    return open_bus(settings, can_filters=nothing)


def stamping_clock(settings: BusSettings) -> Callable[[], float] | None:
    """Return the clock of this computer that stamps frames on arrival; None if the interface has no such stamps.

    The clock of an adapter (kvaser, pcan, vector, gs_usb) is not used: in an hour it drifts by more than the age limit
    of a sample. The stamps of a serial adapter are not used either: its frames are stamped only when they are read.
    """
    return time.time if settings.interface in _HOST_STAMPED else None


def _named_in(settings: BusSettings) -> str:
    if not settings.named_in:
        return ""
    return f" The interface {settings.interface} is named in {settings.named_in}."


def describe_failure(settings: BusSettings, error: Exception) -> str:
    """Return cause and remedy of a failure to open the bus, as text."""
    code = getattr(error, "errno", None) or getattr(error, "error_code", None)
    if settings.interface == "socketcan":
        channel, is_virtual = settings.channel, settings.channel.startswith("vcan")
        bitrate = "" if is_virtual else f" type can bitrate {settings.bitrate or 1_000_000}"
        up = f"sudo ip link set {channel} up{bitrate}"
        if code == errno.ENODEV:
            remedy = f"Plug in the adapter, look for its name with: ip link, and start it: {up}"
            if is_virtual:
                remedy = f"Make it: sudo ip link add {channel} type vcan && {up}"
            return f"There is no CAN device {channel} on this machine. {remedy}"
        if code == errno.ENETDOWN:
            return f"The CAN device {channel} is down. Start it: {up}"
        if code in _NO_CAN_IN_KERNEL:
            return (
                "The kernel of this machine has no CAN sockets. Load their module: sudo modprobe can_raw; "
                "or use -i loopback, which needs none."
            )
    if code in _NOT_ALLOWED:
        return (
            f"This user may not open {settings}. Ask for access to the device (on many systems: "
            "membership of the group that owns it)."
        )
    if isinstance(error, _DRIVER_MISSING):
        return (
            f"The driver of interface {settings.interface} is not installed: {error}. Install it as "
            "its maker and python-can's manual describe."
        )
    reason, remedy = str(error).rstrip("."), "Check the interface and the channel name."
    if isinstance(error, TypeError):  # raised for an option that is missing
        remedy = "State options other than channel and bitrate in ~/can.conf or CAN_CONFIG."
    return f"The bus {settings} cannot be opened: {reason}. {remedy}"


@dataclass(frozen=True, slots=True)
class ArmOnBus:
    """The expected arm, its bus, and how its nodes are set up and timed.

    `pace`: `Pace.FAST_FORWARD` is for simulated arms only, since a real arm needs SYNC at all times.
    """

    description: ArmDescription
    settings: BusSettings
    profile: BusProfile
    _: KW_ONLY
    pace: Pace = Pace.REAL_TIME
    timing: Timing = field(default_factory=Timing)
    open_main: Callable[[BusSettings], can.BusABC] = open_bus
    open_stop: Callable[[BusSettings], can.BusABC] = open_sender
    """Functions that open the two handles on the bus: the main one, and the one that sends STOP."""
