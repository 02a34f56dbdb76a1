"""A bus profile from what was found on a bus: which PDOs carry what is needed. Pure: knows no bus and no file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from hardware.mapping import EVERY_SYNC, ON_RECEIPT
from hardware.pdo_reading import FoundPdo
from hardware.probing import FoundNode
from hardware.profile import (
    ANSWERED,
    COMMANDED,
    FIELD_BITS,
    LEFT_AT_ZERO,
    BusProfile,
    JointProfile,
    Pdo,
)


class NoDraft(Exception):
    """No profile can drive what was found; `reasons` are sentences, each naming its node."""

    def __init__(self, reasons: Sequence[str]) -> None:
        self.reasons = tuple(reasons)
        super().__init__("; ".join(self.reasons))


def draft(nodes: Sequence[FoundNode], *, name: str) -> BusProfile:
    """Profile of the drives found, in the order of their node numbers; joints in this order.

    Raises
    ------
    NoDraft
        There is no drive, or one cannot be driven as it is set up.
    """
    drives = [node for node in nodes if node.drive]
    if not drives:
        raise NoDraft(["no node on this bus says that it is a CiA 402 servo drive (1000h)"])
    reasons = [text for node in drives for text in _lacks(node)]
    if reasons:
        raise NoDraft(reasons)
    supervisor = next((node.node for node in nodes if node.supervises), None)
    serials = [str(node.serial_number or f"node{node.node}") for node in drives]
    return BusProfile(
        name=name,
        joints=tuple(
            JointProfile(
                node=node.node,
                commands=_pdos(_chosen(node.pdos, COMMANDED, sent=False)),
                answers=_pdos(_chosen(node.pdos, ANSWERED, sent=True)),
            )
            for node in drives
        ),
        supervisor=supervisor,
        serial_number="" if supervisor is not None else "-".join(serials),
        compared=frozenset.intersection(*(frozenset(node.described) for node in drives)),
    )


def _chosen(pdos: Iterable[FoundPdo], wanted: Sequence[int], *, sent: bool) -> tuple[FoundPdo, ...]:
    """Fewest PDOs that carry all that is wanted, lowest numbers first; those that carry some, if none do."""
    usable = [pdo for pdo in pdos if pdo.sent is sent and not _unusable(pdo)]
    left, found = set(wanted), list[FoundPdo]()
    while left:
        best = max(usable, key=lambda pdo: len(left & _carried(pdo)), default=None)
        if best is None or not left & _carried(best):
            break
        found.append(best)
        left -= _carried(best)
    return tuple(sorted(found, key=lambda pdo: pdo.number))


def _carried(pdo: FoundPdo) -> set[int]:
    return {index for index, sub, bits in pdo.entries if sub == 0 and bits in FIELD_BITS}


def _unusable(pdo: FoundPdo) -> str:
    """Why a PDO cannot be used; empty if it can."""
    if pdo.sent and pdo.transmission not in EVERY_SYNC:
        return f"is of transmission type {pdo.transmission}, not 1 (on every SYNC)"
    if not pdo.sent and pdo.transmission not in ON_RECEIPT:
        return f"is of transmission type {pdo.transmission}, not 254 or 255 (acted on as it comes)"
    if any(bits % 8 for _, _, bits in pdo.entries):
        return "maps parts of bytes"
    if not pdo.sent:
        others = [i for i, _, _ in pdo.entries if i not in COMMANDED and i not in LEFT_AT_ZERO]
        if others:
            return f"carries {others[0]:04X}h, which is not for this program to command"
    return ""


def _lacks(node: FoundNode) -> Iterator[str]:
    """What keeps a drive from being driven."""
    if not node.pdos:
        told = next(iter(node.problems), "its PDOs could not be read")
        yield told if told.startswith(f"node {node.node}") else f"node {node.node}: {told}"
        return
    for wanted, sent in ((COMMANDED, False), (ANSWERED, True)):
        carried = {i for pdo in _chosen(node.pdos, wanted, sent=sent) for i in _carried(pdo)}
        for index in wanted:
            if index in carried:
                continue
            kind = "TPDO" if sent else "RPDO"
            why = [
                f"{pdo.name} {_unusable(pdo)}"
                for pdo in node.pdos
                if pdo.sent is sent and index in _carried(pdo)
            ]
            because = f" ({'; '.join(why)})" if why else ""
            yield f"node {node.node}: no {kind} carries {index:04X}h as it is needed{because}"


def _pdos(found: Iterable[FoundPdo]) -> tuple[Pdo, ...]:
    return tuple(Pdo(number=pdo.number, cob_id=pdo.cob_id, entries=pdo.entries) for pdo in found)
