"""Describes the traffic on a bus in sentences; sends nothing."""

import math
from collections import Counter
from collections.abc import Iterator
from typing import Final

from hardware.arm import DriveState
from hardware.canopen import objects
from hardware.canopen.bus_profile import BusProfile
from hardware.canopen.cia402 import Command, command_of, state_of
from hardware.canopen.cyclic import frames_of, unpack_emergency
from hardware.canopen.objects import NmtState, emergency_text, node_of
from hardware.monitors.node_monitor import NMT_NAMES, initiated_transfer, nmt_state_name

SILENT_S: Final = 1.5
"""Time without heartbeat after which a node is reported as silent. A SYNC is reported if none came for as long."""
_ABORT, _BLOCK_DOWNLOAD, _BLOCK_ANSWER = 0x80, 6, 5
_EXPEDITED, _SIZED, _BLOCK_SIZED = 0x02, 0x01, 0x02


class BusMonitor:
    """Takes in frames in order and describes what changed; `profile` defines the joints and their frames."""

    def __init__(self, profile: BusProfile) -> None:
        self._joint_of, self._mode_of = profile.joint_of, profile.mode_of
        frames = list(enumerate(frames_of(profile), 1))
        self._answers = {
            identifier: (joint, answer)
            for joint, each in frames
            for identifier, answer in each.answers.items()
        }
        self._commands = {i: (joint, each) for joint, each in frames for i in each.commands}
        self.frames: Counter[int] = Counter()
        self.positions: dict[int, int] = {}
        self.drives: dict[int, DriveState] = {}
        """Last 6064h (`positions`) and drive state of each joint."""
        self.nodes: dict[int, int] = {}
        """NMT state in the last heartbeat of every node."""
        self._heard_s: dict[int, float] = {}
        self._silent: set[int] = set()
        self._modes: dict[int, int] = {}
        self._last_command: dict[int, Command] = {}
        self._sync_s = -math.inf
        self._in_block: set[int] = set()
        self._wrong_lengths: set[int] = set()

    def take_in(self, identifier: int, data: bytes, now_s: float) -> Iterator[str]:
        """Take in a frame; yield one sentence for each change that it shows."""
        self.frames[identifier] += 1
        if (node := node_of(identifier, objects.COB_HEARTBEAT)) and len(data) == 1:
            yield from self._heartbeat(node, data[0] & 0x7F, now_s)
        elif identifier in self._answers:
            yield from self._status(identifier, data)
        elif identifier in self._commands:
            yield from self._command(identifier, data)
        elif identifier == objects.COB_SYNC:
            before_s, self._sync_s = self._sync_s, now_s
            if now_s - before_s > SILENT_S:
                yield "a master has begun to send SYNC"
        elif node := node_of(identifier, objects.COB_EMCY):
            code, _ = unpack_emergency(data) or (None, 0)
            if code is not None:
                text = f"{emergency_text(code)} ({code:04X}h)" if code else "error cleared (0000h)"
                yield f"{self._node_name(node)}: {text}"
        elif identifier == objects.COB_NMT and len(data) == 2:
            to = self._node_name(data[1]) if data[1] else "all nodes"
            yield f"NMT command to {to}: {NMT_NAMES.get(data[0], data[0])}"
        else:
            yield from self._sdo(identifier, data)

    def time_passes(self, now_s: float) -> Iterator[str]:
        """Yield one sentence for each node that has fallen silent since the last call."""
        for node, heard in self._heard_s.items():
            if now_s - heard > SILENT_S and node not in self._silent:
                self._silent.add(node)
                yield f"{self._node_name(node)}: no heartbeat for {now_s - heard:.1f} s"

    def summary(self) -> dict[str, object]:
        """Return, as JSON data, the frames counted so far and the latest states of nodes and joints."""
        return {
            "frames": sum(self.frames.values()),
            "syncs": self.frames[objects.COB_SYNC],
            "nodes": {
                str(node): nmt_state_name(state) for node, state in sorted(self.nodes.items())
            },
            "silent": sorted(self._silent),
            "joints": {
                str(joint): {"drive": drive.value, "position_counts": self.positions.get(joint)}
                for joint, drive in sorted(self.drives.items())
            },
        }

    def _heartbeat(self, node: int, state: int, now_s: float) -> Iterator[str]:
        before = self.nodes.get(node)
        self.nodes[node] = state
        self._heard_s[node] = now_s
        if node in self._silent:
            self._silent.discard(node)
            yield f"{self._node_name(node)}: its heartbeat is back"
        if state == NmtState.BOOT_UP:
            yield f"{self._node_name(node)}: has booted"
        elif before != state:
            yield f"{self._node_name(node)}: {nmt_state_name(state)}"

    def _status(self, identifier: int, data: bytes) -> Iterator[str]:
        joint, answer = self._answers[identifier]
        values = answer.unpack(data)
        if values is None:
            if identifier not in self._wrong_lengths:
                self._wrong_lengths.add(identifier)
                sent = f"TPDO {identifier:03X}h has {len(data)} bytes"
                yield f"joint {joint}: {sent}; the bus profile states {answer.size}, so its data are ignored"
            return
        self._wrong_lengths.discard(identifier)
        if (counts := values.get(objects.POSITION_ACTUAL)) is not None:
            self.positions[joint] = counts
        word = values.get(objects.STATUSWORD)
        if word is not None and self.drives.get(joint) is not state_of(word):
            self.drives[joint] = state_of(word)
            yield f"joint {joint}: drive {self.drives[joint].value}"

    def _command(self, identifier: int, data: bytes) -> Iterator[str]:
        joint, frames = self._commands[identifier]
        values = frames.commands[identifier].unpack(data) or {}
        word, mode = values.get(objects.CONTROLWORD), values.get(objects.MODE)
        if word is not None and self._last_command.get(joint) is not command_of(word):
            self._last_command[joint] = command_of(word)
            yield f"joint {joint}: {command_of(word).value} commanded"
        if mode is not None and self._modes.get(joint) != mode:
            self._modes[joint] = mode
            name = self._mode_of(mode)
            yield f"joint {joint}: {f'mode {mode}' if name is None else f'{name.value} mode'} commanded"

    def _node_name(self, node: int) -> str:
        if node == objects.OPERATOR_NODE:
            return "the operator (node 127)"
        joint = self._joint_of.get(node)
        return f"node {node}" if joint is None else f"joint {joint}"

    def _sdo(self, identifier: int, data: bytes) -> Iterator[str]:
        if len(data) != 8:
            return
        place = f"{int.from_bytes(data[1:3], 'little'):04X}h sub {data[3]}"
        if node := node_of(identifier, objects.COB_SDO_TO_SERVER):
            yield from self._sdo_request(node, data, place)
        elif node := node_of(identifier, objects.COB_SDO_FROM_SERVER):
            if data[0] >> 5 != _BLOCK_ANSWER:
                # The block has ended, even if its last frame was lost.
                self._in_block.discard(node)
            if data[0] == _ABORT:
                code = int.from_bytes(data[4:8], "little")
                yield f"{self._node_name(node)}: access to {place} was refused (abort code {code:08X}h)"

    def _sdo_request(self, node: int, data: bytes, place: str) -> Iterator[str]:
        if node in self._in_block:
            # The first byte of a block's segment is the segment's number, and may look like any request.
            if data[0] == _ABORT or data[0] & 0xE1 == _BLOCK_DOWNLOAD << 5 | 1:
                self._in_block.discard(node)
            return
        writes, _ = initiated_transfer(data) or (False, 0)
        if writes:
            yield f"{self._node_name(node)}: write of {_written(data)} to {place} requested"
            if data[0] >> 5 == _BLOCK_DOWNLOAD:
                self._in_block.add(node)


def _written(data: bytes) -> str:
    """Describe the data of an SDO write request: the value in hex, else the announced size, else just ``data``."""
    block = data[0] >> 5 == _BLOCK_DOWNLOAD
    if data[0] & _EXPEDITED and not block:
        size = 4 - (data[0] >> 2 & 3) if data[0] & _SIZED else 4
        return f"{int.from_bytes(data[4 : 4 + size], 'little'):0{2 * size}X}h"
    sized = data[0] & (_BLOCK_SIZED if block else _SIZED)
    return f"{int.from_bytes(data[4:], 'little')} bytes" if sized else "data"
