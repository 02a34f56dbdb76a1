"""A CAN bus between processes of one machine, over UDP multicast on 127.0.0.1, for machines without kernel CAN.

python-can finds this bus as interface ``loopback`` through the entry point group ``can.interface``. No datagram leaves
the machine: all use the loopback interface, with a time-to-live of 0.

A channel may have any name. The name is hashed to a multicast group and, because names may share a group, to a tag in
every datagram. Only classic frames are supported: CANopen uses no others.
"""

import contextlib
import ctypes
import hashlib
import select
import socket
import struct
import time
from typing import Any

import can
from can.typechecking import CanFilters

DEFAULT_CHANNEL = "sarcal"
MULTICAST_PORT = 43_117
HOST = "127.0.0.1"
RECEIVE_BUFFER_BYTES = 4 * 1024 * 1024

# Linux socket options that the socket module does not name (asm-generic/socket.h, linux/in.h).
_SO_ATTACH_FILTER = 26
_SO_DETACH_FILTER = 27
_SO_RCVBUFFORCE = 33
_SO_TIMESTAMPNS = 35
_IP_MULTICAST_ALL = 49
_ANCILLARY_BYTES = 128

_MAGIC = b"CANo"
_HEADER = struct.Struct("!4s8sBBI")  # magic, channel tag, flags, length code, arbitration id
_EXTENDED, _REMOTE, _ERROR = (1 << bit for bit in range(3))
_ALL_FLAGS = (1 << 3) - 1
_LARGEST_DATAGRAM = _HEADER.size + 8
_FLAGS_AT, _IDENTIFIER_AT = 12, 14

# Classic BPF (linux/filter.h, linux/bpf_common.h); a filter sees a datagram from its UDP header on.
_BPF = struct.Struct("@HBBI")
_LOAD_WORD, _LOAD_BYTE, _AND, _IS_EQUAL, _ANY_BIT, _RETURN = 0x20, 0x30, 0x54, 0x15, 0x45, 0x06
_UDP_HEADER_BYTES = 8


def channel_tag(channel: str) -> bytes:
    """Return eight bytes that identify a channel."""
    return hashlib.sha256(channel.encode()).digest()[:8]


def channel_group(channel: str) -> str:
    """Return the multicast group of a channel, in the administratively scoped block 239.255.0.0/16."""
    tag = channel_tag(channel)
    return f"239.255.{tag[0]}.{tag[1]}"


def encode_frame(message: can.Message, tag: bytes) -> bytes:
    """Return the datagram that carries a frame on the channel with this tag."""
    flags = (
        _EXTENDED * message.is_extended_id
        | _REMOTE * message.is_remote_frame
        | _ERROR * message.is_error_frame
    )
    head = _HEADER.pack(_MAGIC, tag, flags, message.dlc, message.arbitration_id)
    return head if message.is_remote_frame else head + bytes(message.data)


def decode_frame(datagram: bytes, tag: bytes) -> can.Message | None:
    """Return the frame in a datagram; None if the datagram holds no valid frame of the channel with this tag."""
    if len(datagram) < _HEADER.size:
        return None
    magic, its_tag, flags, length, arbitration_id = _HEADER.unpack_from(datagram)
    data = datagram[_HEADER.size :]
    if magic != _MAGIC or its_tag != tag or flags & ~_ALL_FLAGS or (flags & _REMOTE and data):
        return None
    try:
        return can.Message(
            arbitration_id=arbitration_id,
            is_extended_id=bool(flags & _EXTENDED),
            is_remote_frame=bool(flags & _REMOTE),
            is_error_frame=bool(flags & _ERROR),
            dlc=length,
            data=data,
            check=True,
        )
    except ValueError:
        return None


def filter_program(filters: CanFilters) -> bytes:
    """Return a classic BPF program (struct sock_filter, Linux) that passes frames that match at least one filter.

    A frame matches by python-can's rule: ``identifier & mask == id & mask``, and the same identifier length (11 or 29
    bits) if the filter states one.
    """
    code = list[bytes]()
    for can_filter in filters:
        mask = can_filter["can_mask"]
        test = [
            _BPF.pack(_LOAD_WORD, 0, 0, _UDP_HEADER_BYTES + _IDENTIFIER_AT),
            _BPF.pack(_AND, 0, 0, mask),
            _BPF.pack(_IS_EQUAL, 0, 1, can_filter["can_id"] & mask),
            _BPF.pack(_RETURN, 0, 0, _LARGEST_DATAGRAM + _UDP_HEADER_BYTES),
        ]
        if "extended" in can_filter:
            flags = _UDP_HEADER_BYTES + _FLAGS_AT
            of_kind, other = (len(test), 0) if not can_filter["extended"] else (0, len(test))
            code += [
                _BPF.pack(_LOAD_BYTE, 0, 0, flags),
                _BPF.pack(_ANY_BIT, of_kind, other, _EXTENDED),
            ]
        code += test
    return b"".join([*code, _BPF.pack(_RETURN, 0, 0, 0)])


class LoopbackBus(can.BusABC):
    """python-can bus between processes of one machine; the kernel applies the filters."""

    def __init__(
        self,
        channel: str | int = DEFAULT_CHANNEL,
        *,
        can_filters: CanFilters | None = None,
        **kwargs: Any,
    ) -> None:
        name = str(channel or DEFAULT_CHANNEL)
        self.channel = name
        self.channel_info = f"loopback channel {name}"
        self._can_protocol = can.CanProtocol.CAN_20
        self._tag = channel_tag(name)
        self._group = (channel_group(name), MULTICAST_PORT)
        try:
            with contextlib.ExitStack() as closing:
                self._sender, self._receiver = (
                    closing.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
                    for _ in range(2)
                )
                _set_up_sender(self._sender)
                _set_up_receiver(self._receiver, self._group[0])
                closing.pop_all()  # keep them open
        except OSError as error:
            raise can.CanInitializationError(
                f"cannot open loopback channel {name}: {error.strerror}", error.errno
            ) from error
        self._own_address = self._sender.getsockname()
        self._poll = select.poll()
        self._poll.register(self._receiver, select.POLLIN)
        super().__init__(channel=name, can_filters=can_filters, **kwargs)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame; waits at most `timeout` s for room in the kernel."""
        self._check_open()
        if msg.is_fd:
            raise can.CanOperationError("the loopback bus has no CAN FD frames")
        datagram = encode_frame(msg, self._tag)
        try:
            try:
                self._sender.sendto(datagram, socket.MSG_DONTWAIT, self._group)
            except BlockingIOError:
                if not select.select([], [self._sender], [], timeout)[1]:
                    raise can.CanTimeoutError("no room to send on the loopback bus") from None
                self._sender.sendto(datagram, socket.MSG_DONTWAIT, self._group)
        except OSError as error:
            if isinstance(error, can.CanError):
                raise
            raise can.CanOperationError(
                f"cannot send on {self.channel_info}: {error.strerror}", error.errno
            ) from error

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        self._check_open()
        try:
            try:
                received = self._receiver.recvmsg(_LARGEST_DATAGRAM + 1, _ANCILLARY_BYTES)
            except BlockingIOError:
                milliseconds = None if timeout is None else 1e3 * max(timeout, 0.0)
                if not self._poll.poll(milliseconds):
                    return None, False
                received = self._receiver.recvmsg(_LARGEST_DATAGRAM + 1, _ANCILLARY_BYTES)
        except BlockingIOError:
            return None, False  # another thread was faster
        except OSError as error:
            raise can.CanOperationError(
                f"cannot receive on {self.channel_info}: {error.strerror}", error.errno
            ) from error
        datagram, ancillary, _, sender = received
        from_other = sender[0] == HOST and sender != self._own_address
        message = decode_frame(datagram, self._tag) if from_other else None
        if message is None:
            return None, False
        message.timestamp = _arrival_s(ancillary)
        message.channel = self.channel
        return message, False

    def _apply_filters(self, filters: CanFilters | None) -> None:
        """Set the filters in the kernel; if the kernel cannot filter, python-can filters the frames."""
        self._is_filtered = False  # read by python-can
        with contextlib.suppress(OSError):  # too many filters, or not allowed
            if not filters:
                self._receiver.setsockopt(socket.SOL_SOCKET, _SO_DETACH_FILTER, 0)
                return
            program = filter_program(filters)
            buffer = ctypes.create_string_buffer(program, len(program))
            sock_fprog = struct.pack("@HP", len(program) // _BPF.size, ctypes.addressof(buffer))
            self._receiver.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, sock_fprog)
            self._is_filtered = True

    def fileno(self) -> int:
        """Return the descriptor that becomes readable when a frame has arrived; -1 after shutdown."""
        return self._receiver.fileno()

    def shutdown(self) -> None:
        """Close the bus. Safe to call twice."""
        super().shutdown()
        self._sender.close()
        self._receiver.close()

    def _check_open(self) -> None:
        if self._is_shutdown:
            raise can.CanOperationError("this loopback bus has been shut down")


def _arrival_s(ancillary: list[tuple[int, int, bytes]]) -> float:
    for level, kind, value in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(value) >= 16:
            seconds, nanoseconds = struct.unpack_from("@qq", value)
            return float(seconds + nanoseconds * 1e-9)
    return time.time()


def _set_up_sender(sender: socket.socket) -> None:
    """Make a socket send to the loopback interface only, from a free port that identifies the sending bus object."""
    sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(HOST))
    sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
    sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 1)
    sender.bind((HOST, 0))
    sender.setblocking(False)


def enlarge_receive_buffer(receiver: socket.socket) -> None:
    """Enlarge the kernel's queue of unread frames; only root can exceed net.core.rmem_max."""
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
    with contextlib.suppress(PermissionError):
        receiver.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, RECEIVE_BUFFER_BYTES)


def _set_up_receiver(receiver: socket.socket, group: str) -> None:
    receiver.setblocking(False)
    receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    enlarge_receive_buffer(receiver)
    receiver.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    # Otherwise the socket would also receive groups that other programs joined on other interfaces.
    receiver.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
    receiver.bind((group, MULTICAST_PORT))
    membership = socket.inet_aton(group) + socket.inet_aton(HOST)
    receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
