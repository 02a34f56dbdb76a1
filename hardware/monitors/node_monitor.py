"""State of the nodes from heartbeats and emergencies; detection of frames of another CANopen master.

The receiving thread updates the state; any thread may read the public attributes. Times exclude host latency
(`hardware.timing`).
"""

import time
from collections.abc import Callable
from typing import Final

from hardware.arm import Fault
from hardware.canopen import objects
from hardware.canopen.bus_profile import BusProfile
from hardware.canopen.cia402 import CONTROLWORD_QUICK_STOP
from hardware.canopen.cyclic import frames_of, unpack_emergency

_WRITES: Final = {1: True, 2: False, 5: False, 6: True}
"""SDO client command specifiers (download, upload, block upload, block download), and whether they write."""
_CONTINUED_BLOCK: Final = {5: 0x03, 6: 0x01}
"""Subcommand bits of a block transfer that is already running."""


NMT_NAMES: Final = {
    command.value: command.name.lower().replace("_", " ").replace("pre op", "pre-op")
    for command in objects.NmtCommand
}
"""Names of NMT commands for messages."""


def nmt_state_name(state: int) -> str:
    """Return the name of an NMT state for messages."""
    try:
        return objects.NmtState(state).name.lower().replace("_", "-")
    except ValueError:
        return f"NMT state {state}"


def describe_master_frame(profile: BusProfile, identifier: int, data: bytes) -> str:
    """Return a description of a frame, with its COB-ID, if only a master sends such frames; otherwise an empty text.

    TPDOs of the profile count as frames of the nodes, whatever their identifiers.
    """
    cob_id = f"(COB-ID {identifier:03X}h)"
    if identifier == objects.COB_NMT:
        return f"{_describe_nmt(data)} {cob_id}"
    if identifier == objects.COB_SYNC:
        return f"a SYNC {cob_id}"
    if identifier == objects.COB_HEARTBEAT + objects.OPERATOR_NODE:
        return f"the heartbeat of an operator, node {objects.OPERATOR_NODE} {cob_id}"
    if node := objects.node_of(identifier, objects.COB_SDO_TO_SERVER):
        return f"{_describe_sdo(data)} node {node} {cob_id}"
    for joint, drive in enumerate(profile.joints, 1):
        if any(pdo.cob_id == identifier for pdo in drive.answers):
            return ""
        if any(pdo.cob_id == identifier for pdo in drive.commands):
            return f"a command to joint {joint} {cob_id}"
    for at in range(4):  # RPDO1..4 of the predefined connection set
        if node := objects.node_of(identifier, objects.COB_RPDO1 + at * objects.COB_NEXT_PDO):
            return f"a command to node {node}, RPDO{at + 1} {cob_id}"
    return ""


def _describe_nmt(data: bytes) -> str:
    if len(data) != 2:
        return "an NMT command"
    target = f"node {data[1]}" if data[1] else "all nodes"
    return f"the NMT command {NMT_NAMES.get(data[0], data[0])!r} to {target}"


def initiated_transfer(data: bytes) -> tuple[bool, int] | None:
    """Return true if an SDO request initiates a write, false for a read, and the object's index; None for others."""
    kind = data[0] >> 5 if len(data) == 8 else None
    if kind not in _WRITES or data[0] & _CONTINUED_BLOCK.get(kind, 0):
        return None
    return _WRITES[kind], int.from_bytes(data[1:3], "little")


def _describe_sdo(data: bytes) -> str:
    begun = initiated_transfer(data)
    if begun is None:
        return "an SDO transfer with"
    writes, index = begun
    return f"{'a write to' if writes else 'a read of'} {index:04X}h of"


_POLL_S = 0.005
"""Polling period of waits. Waits take no lock, because Ctrl-C could leave the lock locked, and the receiving thread
would then block."""
_TIMEOUT_FACTOR = 5
"""A wait ends after this many times its time-out in wall-clock time, in case no thread receives frames any more."""


class NodeMonitor:
    """State of the nodes of `profile`. `clock` returns the monotonic time minus the accumulated host latency, s."""

    def __init__(
        self,
        profile: BusProfile,
        clock: Callable[[], float] = time.monotonic,
        heartbeat_timeout_s: float = 1.0,
    ) -> None:
        self._clock = clock
        self.heartbeat_timeout_s = heartbeat_timeout_s
        """Silence after which a node is lost; set before SYNC starts."""
        self.profile, self.nodes = profile, profile.nodes
        self._commanded = {i: frames for frames in frames_of(profile) for i in frames.commands}
        self.heard_at_s: dict[int, float] = {}
        """Time of each node's last heartbeat or boot-up."""
        self.nmt_state: dict[int, int] = {}
        """NMT state in each node's last heartbeat."""
        self.faults: tuple[Fault, ...] = ()
        """Active emergencies, oldest first."""
        self.other_operator_at_s: float | None = None
        """Time of the last heartbeat of another operator (node 127); None if never."""
        self.foreign_nodes: frozenset[int] = frozenset()
        """Nodes heard that do not belong to this arm."""
        self.restarted: frozenset[int] = frozenset()
        """Nodes that booted without a command."""
        self.foreign_command = ""
        """Description of the first command from another master on this bus; empty if none."""
        self.cancelled: Callable[[], bool] = lambda: False
        """Function that returns whether waits should end: STOP was pressed, or no thread receives any more."""
        self.boot_expected = False
        """Whether nodes may boot now; otherwise a node that boots is recorded as restarted."""
        self.booted: set[int] = set()
        """Nodes that have booted since `expect_boot_up`."""

    def note_command(self, identifier: int, data: bytes | bytearray) -> None:
        """Record the first command received from another program; none is expected on this bus."""
        if not self.foreign_command and self._is_command(identifier, bytes(data)):
            self.foreign_command = describe_master_frame(self.profile, identifier, bytes(data))

    def note(self, identifier: int, data: bytes | bytearray, sync_count: int) -> None:
        """Take in a heartbeat or an emergency; ignore other frames."""
        if node := objects.node_of(identifier, objects.COB_HEARTBEAT):
            if len(data) == 1:
                self._heartbeat(node, data[0] & 0x7F)
        elif node := objects.node_of(identifier, objects.COB_EMCY):
            code, register = unpack_emergency(data) or (None, 0)
            if code is not None:
                self._emergency(node, code, register, sync_count)

    def expect_boot_up(self) -> None:
        """Expect the nodes to boot, and forget what they sent before; call this before the nodes are reset."""
        self.boot_expected = True
        self.booted.clear()
        self.restarted, self.foreign_command = frozenset(), ""
        self.heard_at_s.clear()
        self.nmt_state.clear()
        self.faults = ()

    def wait_for_nodes(self, ready: Callable[[int], bool], timeout_s: float) -> tuple[int, ...]:
        """Wait until every node is `ready`; return the nodes that are not."""
        self.wait_for(lambda: all(map(ready, self.nodes)), timeout_s)
        return tuple(node for node in self.nodes if not ready(node))

    def wait_for(self, happened: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until `happened` or the attribute `cancelled` returns true; return the last result of `happened`."""
        end_s = self._clock() + timeout_s
        latest_s = time.monotonic() + _TIMEOUT_FACTOR * timeout_s
        while not happened() and not self.cancelled():
            left_s = min(end_s - self._clock(), latest_s - time.monotonic())
            if left_s <= 0.0:
                break
            time.sleep(min(left_s, _POLL_S))
        return happened()

    def silent(self) -> tuple[int, ...]:
        """Return the nodes that were heard before, but not within the last `heartbeat_timeout_s`."""
        since_s, heard_at_s = self._clock() - self.heartbeat_timeout_s, self.heard_at_s
        return tuple(n for n in self.nodes if n in heard_at_s and heard_at_s[n] < since_s)

    def is_operational(self, node: int) -> bool:
        """Whether a node's last heartbeat reports *operational*."""
        return self.nmt_state.get(node) == objects.NmtState.OPERATIONAL

    def not_operational(self) -> tuple[int, ...]:
        """Return the nodes whose last heartbeat reports an NMT state other than *operational*."""
        return tuple(n for n in self.nodes if n in self.nmt_state and not self.is_operational(n))

    @property
    def refusing_joints(self) -> tuple[int, ...]:
        """Joints whose drives report a refused target."""
        return tuple(
            fault.joint
            for fault in self.faults
            if fault.joint is not None and fault.code == objects.EmergencyCode.REFERENCE_LIMIT
        )

    def other_operator(self, limit_s: float) -> bool:
        """Whether another operator's heartbeat was heard within `limit_s`."""
        heard_at_s = self.other_operator_at_s
        return heard_at_s is not None and self._clock() - heard_at_s <= limit_s

    def assume_fault(self, node: int, code: int, sync_count: int) -> None:
        """Add a fault whose emergency was sent before this program listened, unless a fault of the node is known."""
        if all(fault.node != node for fault in self.faults):
            self._emergency(node, code, 0, sync_count)

    def _heartbeat(self, node: int, state: int) -> None:
        if node == objects.OPERATOR_NODE:
            self.other_operator_at_s = self._clock()
        elif node not in self.nodes:
            self.foreign_nodes |= {node}
        else:
            self.heard_at_s[node] = self._clock()
            if state == objects.NmtState.BOOT_UP and self.nmt_state.get(node) != state:
                self.booted.add(node)
                if not self.boot_expected:
                    self.restarted |= {node}
            self.nmt_state[node] = state

    def _emergency(self, node: int, code: int, register: int, sync_count: int) -> None:
        if node not in self.nodes:
            return
        if code == 0:  # an error ended; by the register, others may remain
            if register == 0:
                self.faults = tuple(fault for fault in self.faults if fault.node != node)
            return
        if any((fault.node, fault.code) == (node, code) for fault in self.faults):
            return  # a repetition
        joint, text = self.profile.joint_of.get(node), objects.emergency_text(code)
        fault = Fault(node=node, joint=joint, code=code, text=text, sync_count=sync_count)
        self.faults = (*self.faults, fault)

    def _is_command(self, identifier: int, data: bytes) -> bool:
        """Whether a frame commands this arm. Quick stop does not count: this program's STOP sends it too."""
        if identifier == objects.COB_SYNC:
            return len(data) <= 1  # with a counter or without
        if frames := self._commanded.get(identifier):
            values = frames.commands[identifier].unpack(data) or {}
            return values.get(objects.CONTROLWORD) != CONTROLWORD_QUICK_STOP
        writes, _ = initiated_transfer(data) or (False, 0)
        writes = writes and identifier - objects.COB_SDO_TO_SERVER in self.nodes
        return identifier == objects.COB_NMT or writes
