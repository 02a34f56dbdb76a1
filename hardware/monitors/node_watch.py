"""Heartbeats and emergencies of the nodes, and other operators. Bookkeeping: knows no bus and no command.

Written by the thread that receives; its public attributes may be read from any thread. Times are those
of a clock that stands still while nobody listens (`hardware.monitors.latency`).
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from hardware.arm import Fault
from hardware.canopen.bus_profile import BusProfile
from hardware.canopen.cia402 import CONTROLWORD_QUICK_STOP
from hardware.canopen.cyclic import frames_of, unpack_emergency
from hardware.canopen.masters import begun_transfer
from hardware.canopen.objects import (
    COB_EMCY,
    COB_HEARTBEAT,
    COB_NMT,
    COB_SDO_TO_SERVER,
    COB_SYNC,
    CONTROLWORD,
    OPERATOR_NODE,
    NmtState,
    emergency_text,
)

_GIVEN_UP_S = 0.05
"""How soon a wait notices that it was given up."""
_LATEST = 5
"""Times as long as wanted nodes are waited for, should the thread that listens be gone."""


class NodeWatch:
    """What the nodes said about themselves.

    Parameters
    ----------
    profile
        Nodes that belong to the arm, and the frames that command them.
    clock
        By which nodes are waited for: it stands still while nobody listens.

    Attributes
    ----------
    heard_at_s
        Time of the last heartbeat or boot-up of every node heard so far.
    nmt_state
        State in that heartbeat.
    faults
        Emergencies that are not over, oldest first.
    other_operator_at_s
        When another operator's heartbeat was last heard, None if never.
    strangers
        Nodes whose heartbeat was heard though they are none of this arm's; without node 127.
    restarted
        Nodes that booted without being told to.
    given_up
        Whether nobody wants any more what is waited for, or nobody listens for it.
    intrusion
        What somebody else commands on this bus, in words; empty if nobody was seen to.
    """

    def __init__(self, profile: BusProfile, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self.profile, self.nodes = profile, profile.nodes
        self._commanded = {
            identifier: (joint, frames)
            for joint, frames in enumerate(frames_of(profile), 1)
            for identifier in frames.command_ids
        }
        self.heard_at_s: dict[int, float] = {}
        self.nmt_state: dict[int, int] = {}
        self.faults: tuple[Fault, ...] = ()
        self.other_operator_at_s: float | None = None
        self.strangers: frozenset[int] = frozenset()
        self.restarted: frozenset[int] = frozenset()
        self.intrusion = ""
        self.given_up: Callable[[], bool] = lambda: False
        self._expecting = False
        self._booted: set[int] = set()
        self._changed = threading.Condition()

    def note_command(self, identifier: int, data: bytes | bytearray) -> None:
        """Take in a frame that commands: the only one on this bus to send such is this program."""
        if not self.intrusion:
            self.intrusion = self._command_of_others(identifier, bytes(data))

    def note(self, identifier: int, data: bytes | bytearray, now_s: float, sync_count: int) -> None:
        """Take in a frame; others than heartbeats and emergencies are not looked at."""
        if COB_HEARTBEAT < identifier <= COB_HEARTBEAT + OPERATOR_NODE:
            if len(data) == 1:
                self._heartbeat(identifier - COB_HEARTBEAT, data[0] & 0x7F, now_s)
        elif COB_EMCY < identifier <= COB_EMCY + OPERATOR_NODE:
            code = unpack_emergency(data)
            if code is not None:
                self._emergency(identifier - COB_EMCY, code, sync_count)

    def expect_boot_up(self) -> None:
        """Forget earlier boot-ups; call before resetting the nodes."""
        with self._changed:
            self._booted.clear()
            self._expecting = True
        self.restarted, self.intrusion = frozenset(), ""
        self.heard_at_s.clear()
        self.nmt_state.clear()
        self.faults = ()

    def expect_no_boot_up(self) -> None:
        """From now on a node that boots was not told to."""
        self._expecting = False

    def wait_for_boot_up(self, timeout_s: float) -> tuple[int, ...]:
        """Wait until every node has booted; return those that have not after `timeout_s`."""
        with self._changed:
            self._wait_for(lambda: self._booted.issuperset(self.nodes), timeout_s)
            return tuple(node for node in self.nodes if node not in self._booted)

    def wait_for_state(self, state: NmtState, timeout_s: float) -> tuple[int, ...]:
        """Wait until every node's heartbeat names `state`; return those that do not in time."""

        def others() -> tuple[int, ...]:
            return tuple(node for node in self.nodes if self.nmt_state.get(node) != state)

        with self._changed:
            self._wait_for(lambda: not others(), timeout_s)
            return others()

    def wait_for_other_operator(self, timeout_s: float) -> bool:
        """Listen for `timeout_s`; whether another operator's heartbeat was heard."""
        with self._changed:
            return self._wait_for(lambda: self.other_operator_at_s is not None, timeout_s)

    def silent(self, now_s: float, limit_s: float) -> tuple[int, ...]:
        """Nodes that were heard once, and not for longer than `limit_s`."""
        return tuple(
            node
            for node in self.nodes
            if node in self.heard_at_s and now_s - self.heard_at_s[node] > limit_s
        )

    def not_operational(self) -> tuple[int, ...]:
        """Nodes whose last heartbeat names another NMT state (a node that restarted, say)."""
        return tuple(
            node
            for node in self.nodes
            if self.nmt_state.get(node, NmtState.OPERATIONAL) != NmtState.OPERATIONAL
        )

    def other_operator(self, now_s: float, limit_s: float) -> bool:
        """Whether another operator's heartbeat was heard within `limit_s`."""
        return self.other_operator_at_s is not None and now_s - self.other_operator_at_s <= limit_s

    def assume_fault(self, node: int, code: int, sync_count: int) -> None:
        """Take in a fault that began before anybody listened; not one that is known already."""
        if all(fault.node != node for fault in self.faults):
            self._emergency(node, code, sync_count)

    def forget_faults(self) -> None:
        """Start a new list of emergencies."""
        self.faults = ()
        self.intrusion = ""

    def _wait_for(self, happened: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until something has happened, or nobody wants it any more: STOP wakes nobody, it takes no lock."""
        end_s, latest_s = self._clock() + timeout_s, time.monotonic() + _LATEST * timeout_s
        while not happened() and not self.given_up():
            left_s = min(end_s - self._clock(), latest_s - time.monotonic())
            if left_s <= 0.0:
                break
            self._changed.wait(min(left_s, _GIVEN_UP_S))
        return happened()

    def _heartbeat(self, node: int, state: int, now_s: float) -> None:
        if node == OPERATOR_NODE:
            with self._changed:
                self.other_operator_at_s = now_s
                self._changed.notify_all()
        elif node not in self.nodes:
            self.strangers |= {node}
        else:
            self.heard_at_s[node] = now_s
            if self.nmt_state.get(node) != state:
                with self._changed:
                    self.nmt_state[node] = state
                    if state == NmtState.BOOT_UP:
                        self._booted.add(node)
                        if not self._expecting:
                            self.restarted |= {node}
                    self._changed.notify_all()

    def _emergency(self, node: int, code: int, sync_count: int) -> None:
        if node not in self.nodes:
            return
        if code == 0:  # error reset or no error
            self.faults = tuple(fault for fault in self.faults if fault.node != node)
            return
        if any((fault.node, fault.code) == (node, code) for fault in self.faults):
            return  # said already: a drive that goes on complaining says nothing new
        fault = Fault(
            node=node,
            joint=self.profile.joint_of.get(node),
            code=code,
            text=emergency_text(code),
            sync_count=sync_count,
        )
        self.faults = (*self.faults, fault)

    def _command_of_others(self, identifier: int, data: bytes) -> str:
        """Say what a frame commands; empty if nothing, or nothing but a stop."""
        if identifier == COB_SYNC and len(data) <= 1:  # with a counter or without
            return "a SYNC (080h)"
        if identifier == COB_NMT:
            return "an NMT command (000h)"
        if identifier in self._commanded:
            joint, frames = self._commanded[identifier]
            if frames.commanded(identifier, data).get(CONTROLWORD) == CONTROLWORD_QUICK_STOP:
                return ""  # our own STOP, which has a handle of its own, or somebody else's: both are good
            return f"a command to joint {joint} ({identifier:03X}h)"
        node = identifier - COB_SDO_TO_SERVER
        writes, index = begun_transfer(data) or (False, 0)
        return f"a write to {index:04X}h of node {node}" if writes and node in self.nodes else ""
