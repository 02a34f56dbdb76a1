"""An arm of plain `canopen.LocalNode` drives, set up in a way of their own: nothing of the project's in it.

Two PDOs each way where ours has one, other numbers and identifiers, another order, wider torque and mode,
joints on other nodes, one drive that counts backwards, no supervisor, none of our own objects. Written
from CiA 301 and CiA 402; PDOs are packed and unpacked, and SDO is served, by the `canopen` package.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import can
import canopen
from canopen.objectdictionary import ODRecord, ODVariable, datatypes

U8, U16, U32 = datatypes.UNSIGNED8, datatypes.UNSIGNED16, datatypes.UNSIGNED32
I16, I32, TEXT = datatypes.INTEGER16, datatypes.INTEGER32, datatypes.VISIBLE_STRING

PLAIN = {
    0x1000: (U32, 0x0002_0192),
    0x1001: (U8, 0),
    0x1005: (U32, 0x80),
    0x1008: (TEXT, "Acme servo"),
    0x1017: (U16, 200),
    0x603F: (U16, 0),
    0x6040: (U16, 0),
    0x6041: (U16, 0),
    0x6060: (I16, 0),
    0x6061: (I16, 0),
    0x6064: (I32, 0),
    0x606C: (I32, 0),
    0x6071: (I16, 0),
    0x6076: (U32, 20_000),
    0x6077: (I32, 0),
    0x607A: (I32, 0),
}
PDOS = {
    # In: position first, then the word; mode and a torque that stays zero in another frame.
    0x1401: (0x300, 255, (0x607A0020, 0x60400010)),
    0x1402: (0x400, 254, (0x60600010, 0x60710010)),
    # Out: torque, four bytes wide, before the position; mode and word in another frame.
    0x1802: (0x380, 1, (0x60770020, 0x60640020)),
    0x1803: (0x480, 1, (0x60610010, 0x60410010)),
}
LADDER = (0x40, 0x21, 0x23, 0x27)


def dictionary(node: int, serial: int) -> canopen.ObjectDictionary:
    od = canopen.ObjectDictionary()
    od.node_id = node

    def entry(index: int, sub: int, kind: int, value: int | str) -> ODVariable:
        made = ODVariable(f"object {index:04X} {sub}", index, sub)
        made.data_type, made.access_type, made.default = kind, "rw", value
        return made

    for index, (kind, value) in PLAIN.items():
        od.add_object(entry(index, 0, kind, value))
    od.add_object(entry(0x1014, 0, U32, 0x80 + node))
    records: dict[int, list[tuple[int, int]]] = {
        0x1018: [(U8, 4), (U32, 0xACE), (U32, 7), (U32, 1), (U32, serial)],
        0x60C2: [(U8, 2), (U8, 10), (datatypes.INTEGER8, -3)],
    }
    for index, (cob_id, transmission, mapped) in PDOS.items():
        records[index] = [(U8, 2), (U32, cob_id + node), (U8, transmission)]
        records[index + 0x200] = [(U8, len(mapped)), *((U32, entry) for entry in mapped)]
    for index, values in records.items():
        record = ODRecord(f"record {index:04X}", index)
        for sub, (kind, value) in enumerate(values):
            record.add_member(entry(index, sub, kind, value))
        od.add_object(record)
    return od


@dataclass
class Axis:
    """What one drive does; counts are its own, which may run backwards."""

    counts: int
    direction: int = 1
    status: int = 0x40
    word: int = 0
    mode: int = 0
    target: int = 0

    def obey(self, word: int, target: int) -> None:
        if word & 0x80 and not self.word & 0x80 and self.status == 0x08:
            self.status = 0x40
        elif not word & 0x80:
            self.status = self._next(word)
        self.word, self.target = word, target

    def _next(self, word: int) -> int:
        if self.status == 0x08 or not word & 0x02:
            return self.status if self.status == 0x08 else 0x40
        if not word & 0x04:
            return 0x07 if self.status in (0x27, 0x07) else 0x40
        if self.status == 0x07:
            return 0x07
        at, to = LADDER.index(self.status), LADDER.index({6: 0x21, 7: 0x23, 15: 0x27}[word & 15])
        return LADDER[at + 1] if to > at else LADDER[to]


Physics = Callable[[list[Axis]], None]
"""One control period: moves the axes' counts."""


def servo(axes: list[Axis]) -> None:
    """Every joint in position mode is where it is told."""
    for axis in axes:
        if axis.status == 0x27 and axis.mode == 8:
            axis.counts = axis.target


class ForeignArm:
    """Drives on a bus; `move_on` is called with every SYNC."""

    def __init__(
        self, bus: can.BusABC, nodes: Sequence[int], axes: list[Axis], physics: Physics = servo
    ) -> None:
        self.axes, self._physics = axes, physics
        self.network = canopen.Network(bus)
        self.network.connect()
        self.nodes = [
            self.network.create_node(
                canopen.LocalNode(node, dictionary(node, serial=50_000 + node))
            )
            for node in nodes
        ]
        for node, axis in zip(self.nodes, axes, strict=True):
            # `LocalNode` takes a reset for a state to be in: boot in its stead.
            self.network.unsubscribe(0, node.nmt.on_command)
            node.rpdo.read()
            node.tpdo.read()
            node.rpdo[2].add_callback(self._told(axis))
            node.rpdo[3].add_callback(self._mode(axis))
            node.add_read_callback(self._reader(axis))
        self.network.subscribe(0x000, self._nmt)
        self.network.subscribe(0x080, self._sync)
        self._boot()

    def close(self) -> None:
        for node in self.nodes:
            node.nmt.stop_heartbeat()
        self.network.disconnect()

    def _boot(self, number: int = 0) -> None:
        for node in self.nodes:
            if number in (0, node.id):
                node.nmt.stop_heartbeat()
                node.nmt.send_command(129)
                node.nmt.send_command(128)

    def _nmt(self, _id: int, data: bytearray, _stamp: float) -> None:
        if data[0] in (129, 130):
            self._boot(data[1])
            return
        for node in self.nodes:
            if data[1] in (0, node.id):
                node.nmt.send_command(data[0])

    def _told(self, axis: Axis) -> Callable[[canopen.pdo.PdoMap], None]:
        return lambda pdo: axis.obey(pdo[0x6040].raw, pdo[0x607A].raw)

    def _mode(self, axis: Axis) -> Callable[[canopen.pdo.PdoMap], None]:
        def take(pdo: canopen.pdo.PdoMap) -> None:
            assert pdo[0x6071].raw == 0
            axis.mode = pdo[0x6060].raw

        return take

    def _reader(self, axis: Axis) -> Callable[..., int | None]:
        values: dict[int, Callable[[], int]] = {
            0x6041: lambda: axis.status | 0x1200,
            0x6061: lambda: axis.mode,
            0x6064: lambda: axis.counts,
        }

        def read(*, index: int, subindex: int, od: ODVariable) -> int | None:
            return values[index]() if index in values else None

        return read

    def _sync(self, _id: int, _data: bytearray, _stamp: float) -> None:
        self._physics(self.axes)
        for node, axis in zip(self.nodes, self.axes, strict=True):
            if node.nmt.state != "OPERATIONAL":
                continue
            first, second = node.tpdo[3], node.tpdo[4]
            first[0x6077].raw, first[0x6064].raw = 0, axis.counts
            second[0x6061].raw, second[0x6041].raw = axis.mode, axis.status | 0x1200
            first.transmit()
            second.transmit()


@contextmanager
def foreign_arm(
    bus: can.BusABC, nodes: Sequence[int], axes: list[Axis], physics: Physics = servo
) -> Iterator[ForeignArm]:
    arm = ForeignArm(bus, nodes, axes, physics)
    try:
        yield arm
    finally:
        arm.close()
