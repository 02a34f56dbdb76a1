"""Which CAN bus, and opening it with errors a person can act on. Knows python-can; no node and no arm.

Settings use python-can's own names and sources, strongest first: command-line options
(``-i/--interface -c/--channel -b/--bitrate``), the environment (``CAN_INTERFACE``, ``CAN_CHANNEL``,
``CAN_BITRATE``, ``CAN_CONFIG``) and ``can.conf``. Without any of them the interface is ``virtual``. An interface
may also be an arm that another package offers (`arm_offers`): a name and a channel, and no CAN bus.
"""

from __future__ import annotations

import errno
import logging
import socket
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import can
from can.interfaces import virtual
from can.interfaces.socketcan import SocketcanBus
from can.util import load_config, load_environment_config, load_file_config

from hardware.arm_plugins import offered_names
from hardware.buses.loopback import DEFAULT_CHANNEL, LoopbackBus
from hardware.errors import BusError, BusSettingsError

# What these libraries log about a failed start comes to the caller as BusError, in better words.
for _library in ("can", "canopen"):
    logging.getLogger(_library).addHandler(logging.NullHandler())

DEFAULT_INTERFACE = "virtual"
_SERIAL = frozenset({"slcan", "serial", "robotell", "seeedstudio"})
"""Adapters on a serial line: to open one anew, or to close a second handle, closes it for the first as well."""
_STAMPED_HERE = frozenset({"socketcan", "loopback", "udp_multicast", "virtual"})
"""Interfaces whose frames this computer stamps by the time of day: the kernel as they come, or, in one
process, whoever sends them."""
_OWN_CHANNEL = frozenset({"virtual", "loopback"})
_NO_CAN_IN_KERNEL = frozenset({errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT})
_NOT_ALLOWED = frozenset({errno.EPERM, errno.EACCES})


@dataclass(frozen=True, slots=True, kw_only=True)
class BusSettings:
    """A bus by python-can's names.

    Attributes
    ----------
    interface
        ``virtual`` (inside this process), ``loopback`` (between processes of this machine),
        ``socketcan``, or any other interface python-can knows.
    channel
        What the interface calls the bus.
    bitrate
        In bit/s; None leaves it as it is. ``virtual``, ``loopback`` and ``socketcan`` do not use it.
    options
        Anything else, from ``can.conf`` or ``CAN_CONFIG``, passed on to python-can.
    named_in
        File that named the interface, for what is said where it does not work; else empty.
    """

    interface: str = DEFAULT_INTERFACE
    channel: str = DEFAULT_CHANNEL
    bitrate: int | None = None
    options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    named_in: str = field(default="", compare=False)

    def __str__(self) -> str:
        return f"{self.interface} {self.channel}"


def known_interfaces() -> tuple[str, ...]:
    """Names that an interface may have: python-can's, this project's, and arms that packages offer."""
    return tuple(sorted({*can.VALID_INTERFACES, *_OWN_CHANNEL, *offered_names()}))


def bus_settings(
    interface: str | None = None,
    channel: str | None = None,
    bitrate: int | None = None,
    *,
    otherwise: BusSettings | None = None,
) -> BusSettings:
    """Settings from options, completed from the environment and ``can.conf``.

    Where none of them names an interface it is `otherwise`, by default the virtual bus.

    Raises
    ------
    BusSettingsError
        If there is no such interface, a bitrate is not a number, or a channel is missing.
    """
    asked: dict[str, Any] = {}
    if interface is not None:
        asked["interface"] = interface
    if channel is not None:
        asked["channel"] = channel
    if bitrate is not None:
        asked["bitrate"] = bitrate
    try:
        named = {**load_file_config(), **load_environment_config(), **asked}
        chosen_name = named.get("interface") or named.get("bustype")
        if chosen_name is None and otherwise is not None:
            try:
                usual = bus_settings(
                    otherwise.interface,
                    channel or named.get("channel") or otherwise.channel or None,
                    bitrate or (None if "bitrate" in named else otherwise.bitrate),
                )
            except BusSettingsError as error:
                raise BusSettingsError(f"{error}{_named_in(otherwise)}") from error
            return replace(usual, named_in=otherwise.named_in)
        if chosen_name is None:
            asked["interface"] = DEFAULT_INTERFACE
        elif chosen_name not in can.VALID_INTERFACES and chosen_name in offered_names():
            rate = named.get("bitrate")
            return BusSettings(
                interface=chosen_name,
                channel=str(named.get("channel", "")),
                bitrate=None if rate is None else int(rate),
            )
        found: dict[str, Any] = dict(load_config(config=asked))
    except can.CanInterfaceNotImplementedError as error:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        arms = ", ".join(offered_names())
        offered = f" Arms that installed packages offer: {arms}." if arms else ""
        raise BusSettingsError(f"{error}. Use one of: {known}.{offered}") from error
    except (ValueError, TypeError) as error:
        raise BusSettingsError(
            f"The bus settings cannot be read: {error}. Look at can.conf and at the environment "
            "variables that start with CAN_."
        ) from error
    chosen, where, rate = (
        found.pop("interface"),
        found.pop("channel"),
        found.pop("bitrate", None),
    )
    if where is None and chosen not in _OWN_CHANNEL:
        raise BusSettingsError(
            f"No channel is given for interface {chosen}. Say which one, for example "
            f"-i {chosen} -c {'can0' if chosen == 'socketcan' else '0'}."
        )
    if rate is not None and not (isinstance(rate, int) and rate > 0):
        raise BusSettingsError(
            f"The bitrate {rate!r} is not a number of bits a second, such as 1000000."
        )
    if where is not None and not str(where).isprintable():
        raise BusSettingsError(
            f"The channel name {str(where)!a} has characters that no channel is named with."
        )
    return BusSettings(
        interface=str(chosen),
        channel=DEFAULT_CHANNEL if where is None else str(where),
        bitrate=rate,
        options=MappingProxyType(found),
    )


def open_bus(settings: BusSettings) -> can.BusABC:
    """Open a bus for sending and receiving.

    Raises
    ------
    BusError
        What happened, and what to do now.
    """
    return _open(settings, {})


def open_sender(settings: BusSettings) -> can.BusABC:
    """Open a second handle on a bus that only sends: what STOP uses, whatever the first one does.

    Frames of others do not pile up behind it.

    Raises
    ------
    BusError
        What happened, and what to do now.
    """
    match settings.interface:
        case "virtual":
            return _VirtualSender(settings.channel)
        case "loopback":
            return _open(settings, {"send_only": True})
        case serial if serial in _SERIAL:
            raise BusError(f"An adapter on a serial line opens once: {settings}.")
        case _:
            # A filter that matches nothing: standard identifiers end at 7FFh.
            nothing = [{"can_id": 0x1FFFFFFF, "can_mask": 0x1FFFFFFF, "extended": False}]
            return _open(settings, {"can_filters": nothing})


def stamping_clock(settings: BusSettings) -> Callable[[], float] | None:
    """Clock of this computer that stamps frames as they come; None where the stamps are of another, or of reading.

    An adapter's own clock (kvaser, pcan, vector, gs_usb) runs apart from ours by more in an hour than what
    data may be old; on a serial line frames are stamped as they are read.
    """
    return time.time if settings.interface in _STAMPED_HERE else None


def _open(settings: BusSettings, extra: dict[str, Any]) -> can.BusABC:
    if settings.interface not in can.VALID_INTERFACES and settings.interface in offered_names():
        raise BusError(
            f"{settings.interface} is an arm that an installed package offers, and no CAN bus: name the arm "
            "where an arm is wanted, and a bus of python-can's here."
        )
    options = {**settings.options, **extra}
    if settings.bitrate is not None:
        options["bitrate"] = settings.bitrate
    try:
        if settings.interface == "loopback":  # also when this project is run without installation
            return LoopbackBus(settings.channel, **options)
        bus = can.Bus(
            interface=settings.interface,
            channel=settings.channel,
            ignore_config=True,
            **options,
        )
    except Exception as error:  # drivers that are not installed raise what they like
        raise BusError(_words(settings, error) + _named_in(settings)) from error
    if isinstance(bus, SocketcanBus):
        pending = bus.socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if pending:  # a device that exists and is down lets itself be opened
            bus.shutdown()
            down = _words(settings, OSError(pending, ""))
            raise BusError(down + _named_in(settings))
    return bus


def _named_in(settings: BusSettings) -> str:
    """Where the interface comes from, if a file named it that nobody typed just now."""
    if not settings.named_in:
        return ""
    return f" The interface {settings.interface} is named in {settings.named_in}."


def _words(settings: BusSettings, error: Exception) -> str:
    """What happened and what to do now."""
    code = getattr(error, "errno", None) or getattr(error, "error_code", None)
    channel = settings.channel
    if settings.interface == "socketcan":
        virtual_device = channel.startswith("vcan")
        up = (
            f"sudo ip link set {channel} up"
            if virtual_device
            else f"sudo ip link set {channel} up type can bitrate {settings.bitrate or 1_000_000}"
        )
        if code == errno.ENODEV and virtual_device:
            return (
                f"There is no CAN device {channel} on this machine. Make it: "
                f"sudo ip link add {channel} type vcan && {up}"
            )
        if code == errno.ENODEV:
            return (
                f"There is no CAN device {channel} on this machine. Plug in the adapter, look for "
                f"its name with: ip link, and start it: {up}"
            )
        if code == errno.ENETDOWN:
            return f"The CAN device {channel} is down. Start it: {up}"
        if code in _NO_CAN_IN_KERNEL:
            return (
                "The kernel of this machine has no CAN sockets. Load them: sudo modprobe can_raw; "
                "or use -i loopback, which needs none."
            )
    if code in _NOT_ALLOWED:
        return (
            f"This user may not open {settings}. Ask for access to the device (on many systems: "
            "membership of the group that owns it)."
        )
    if isinstance(
        error, can.CanInterfaceNotImplementedError | NameError | ImportError | AttributeError
    ):
        return (
            f"The driver for interface {settings.interface} is not there: {error}. Install what "
            "its maker and python-can's manual ask for."
        )
    return (
        f"The bus {settings} cannot be opened: {error}. Check the interface and the channel name."
    )


class _VirtualSender(virtual.VirtualBus):
    """In-process handle whose own queue is not on the channel, so that nothing fills it."""

    def __init__(self, channel: str) -> None:
        super().__init__(channel=channel)
        with virtual.channels_lock:
            self.channel.remove(self.queue)

    def shutdown(self) -> None:
        """Close the handle. Safe to call twice."""
        with virtual.channels_lock:
            if self._open:
                self.channel.append(self.queue)  # where the base class expects to find it
            super().shutdown()
