"""An arm of plain `canopen.LocalNode` drives with another PDO mapping; shares no code with the project.

Two PDOs each way, other numbers and identifiers, another order, wider torque and mode, other node numbers, one
reversed drive, no supervisor, no manufacturer objects. From CiA 301 and CiA 402, with the `canopen` package.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial

import can
import canopen
from canopen.objectdictionary import ODRecord, ODVariable, datatypes
from canopen.sdo import SdoAbortedError

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
    # Received: target position, controlword; mode and a constant zero torque.
    0x1401: (0x300, 255, (0x607A0020, 0x60400010)),
    0x1402: (0x400, 254, (0x60600010, 0x60710010)),
    # Transmitted: torque of four bytes, position; mode and statusword.
    0x1802: (0x380, 1, (0x60770020, 0x60640020)),
    0x1803: (0x480, 1, (0x60610010, 0x60410010)),
}
LADDER = (0x40, 0x21, 0x23, 0x27)


def dictionary(node: int, serial: int) -> canopen.ObjectDictionary:
    od = canopen.ObjectDictionary()
    od.node_id = node

    def entry(index: int, sub: int, kind: int, value: int | str) -> ODVariable:
        variable = ODVariable(f"object {index:04X} {sub}", index, sub)
        variable.data_type, variable.access_type, variable.default = kind, "rw", value
        return variable

    for index, (kind, value) in PLAIN.items():
        od.add_object(entry(index, 0, kind, value))
    od.add_object(entry(0x1014, 0, U32, 0x80 + node))
    records: dict[int, list[tuple[int, int]]] = {
        0x1018: [(U8, 4), (U32, 0xACE), (U32, 7), (U32, 1), (U32, serial)],
        0x60C2: [(U8, 2), (U8, 10), (datatypes.INTEGER8, -3)],
    }
    for index, (cob_id, transmission, mapped) in PDOS.items():
        records[index] = [(U8, 2), (U32, cob_id + node), (U8, transmission)]
        spare = [0] * (8 - len(mapped))
        records[index + 0x200] = [(U8, len(mapped)), *((U32, m) for m in (*mapped, *spare))]
    for index, values in records.items():
        record = ODRecord(f"record {index:04X}", index)
        for sub, (kind, value) in enumerate(values):
            record.add_member(entry(index, sub, kind, value))
        od.add_object(record)
    return od


@dataclass
class Axis:
    """State machine and position of one drive; its counts may be reversed."""

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


NOT_VALID = 1 << 31
READ_ONLY, CANNOT_BE_MAPPED, TOO_LONG, NOT_NOW = 0x06010002, 0x06040041, 0x06040042, 0x08000022


class Drive(canopen.LocalNode):
    """A drive with PDO configuration by SDO (CiA 301), lost at a reset; records of `fixed` are read-only."""

    def __init__(self, node: int, serial: int) -> None:
        super().__init__(node, dictionary(node, serial))
        self.fixed: set[int] = set()
        self.written: list[tuple[int, int, int]] = []
        self._before: dict[tuple[int, int], bytes] = {}

    def set_data(
        self, index: int, subindex: int, data: bytes, check_writable: bool = False
    ) -> None:
        if check_writable and index & 0xF000 == 0x1000:
            self._allow(index, subindex, int.from_bytes(data, "little"))
            self._before.setdefault((index, subindex), self.get_data(index, subindex))
            self.written.append((index, subindex, int.from_bytes(data, "little")))
        super().set_data(index, subindex, data, check_writable)

    def restore(self) -> None:
        """Restore the values at power-on."""
        for (index, subindex), data in self._before.items():
            super().set_data(index, subindex, data)
        self._before.clear()

    def value_of(self, index: int, subindex: int) -> int:
        return int.from_bytes(self.get_data(index, subindex), "little")

    def _allow(self, index: int, subindex: int, value: int) -> None:
        if index in self.fixed:
            raise SdoAbortedError(READ_ONLY)
        if self.nmt.state not in ("PRE-OPERATIONAL", "INITIALISING"):
            raise SdoAbortedError(NOT_NOW)
        if index & 0xFE00 in (0x1400, 0x1800) and subindex == 1:
            current = self.value_of(index, 1)
            changed = (current ^ value) & ~NOT_VALID
            if not current & NOT_VALID and not value & NOT_VALID and changed:
                raise SdoAbortedError(NOT_NOW)
        if index & 0xFE00 in (0x1600, 0x1A00):
            if not self.value_of(index - 0x200, 1) & NOT_VALID:
                raise SdoAbortedError(NOT_NOW)
            if subindex and self.value_of(index, 0):
                raise SdoAbortedError(NOT_NOW)
            if subindex and value >> 16 not in self.object_dictionary:
                raise SdoAbortedError(CANNOT_BE_MAPPED)
            if not subindex and sum(self.value_of(index, k + 1) & 0xFF for k in range(value)) > 64:
                raise SdoAbortedError(TOO_LONG)


Physics = Callable[[list[Axis]], None]
"""Updates the axes' counts in a control period."""


def servo(axes: list[Axis]) -> None:
    """Every joint in position mode is at its target."""
    for axis in axes:
        if axis.status == 0x27 and axis.mode == 8:
            axis.counts = axis.target


def read_object(axis: Axis, *, index: int, **_: object) -> int | None:
    """Return the value of an object that changes, None for others."""
    values = {0x6041: axis.status | 0x1200, 0x6061: axis.mode, 0x6064: axis.counts}
    return values.get(index)


class ForeignArm:
    """Drives on a bus; `physics` is called at every SYNC."""

    def __init__(
        self, bus: can.BusABC, nodes: Sequence[int], axes: list[Axis], physics: Physics = servo
    ) -> None:
        self.axes, self._physics = axes, physics
        self.network = canopen.Network(bus)
        self.network.NOTIFIER_CYCLE = 0.05  # to close sooner
        self.network.connect()
        self.nodes = [self.network.create_node(Drive(node, serial=50_000 + node)) for node in nodes]
        for node, axis in zip(self.nodes, axes, strict=True):
            # `LocalNode` treats a reset as a state: boot instead.
            self.network.unsubscribe(0, node.nmt.on_command)
            node.add_read_callback(partial(read_object, axis))
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
                node.restore()
                node.nmt.send_command(129)
                node.nmt.send_command(128)

    def _nmt(self, _id: int, data: bytearray, _stamp: float) -> None:
        if data[0] in (129, 130):
            self._boot(data[1])
            return
        for node, axis in zip(self.nodes, self.axes, strict=True):
            if data[1] in (0, node.id):
                if data[0] == 1:
                    self._apply_pdos(node, axis)
                node.nmt.send_command(data[0])

    def _apply_pdos(self, node: Drive, axis: Axis) -> None:
        for pdo in node.rpdo.values():
            if pdo.cob_id is not None:
                with suppress(KeyError, ValueError):
                    self.network.unsubscribe(pdo.cob_id, pdo.on_message)
            pdo.callbacks.clear()
        node.rpdo.read()
        node.tpdo.read()
        for pdo in node.rpdo.values():
            pdo.add_callback(self._receiver(axis))

    def _receiver(self, axis: Axis) -> Callable[[canopen.pdo.PdoMap], None]:
        def receive(pdo: canopen.pdo.PdoMap) -> None:
            values = {variable.index: variable.raw for variable in pdo}
            assert values.get(0x6071, 0) == 0
            axis.mode = values.get(0x6060, axis.mode)
            if 0x6040 in values:
                axis.obey(values[0x6040], values.get(0x607A, axis.target))

        return receive

    def _sync(self, _id: int, _data: bytearray, _stamp: float) -> None:
        self._physics(self.axes)
        for node, axis in zip(self.nodes, self.axes, strict=True):
            if node.nmt.state != "OPERATIONAL":
                continue
            for pdo in node.tpdo.values():
                if pdo.enabled and pdo.trans_type == 1:
                    for variable in pdo:
                        variable.raw = read_object(axis, index=variable.index) or 0
                    pdo.transmit()
