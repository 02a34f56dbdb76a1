"""Drafts a bus profile from the nodes found on a bus."""

from collections.abc import Iterator, Sequence
from typing import Final

from hardware.canopen import bus_profile
from hardware.canopen.bus_profile import RPDO, TPDO, BusProfile, Entry, JointProfile, Pdo, PdoKind
from hardware.canopen.drive_settings import DrivePdo
from hardware.canopen.objects import COB_NEXT_PDO
from hardware.commissioning.probe import FoundNode

FRAME_BITS: Final = 64


class DraftRefused(Exception):
    """No profile is possible; `reasons` are sentences that name the node."""

    def __init__(self, reasons: Sequence[str]) -> None:
        self.reasons = tuple(reasons)
        super().__init__("; ".join(self.reasons))


def draft(nodes: Sequence[FoundNode], *, name: str, configure: bool = False) -> BusProfile:
    """Return a profile of the drives among `nodes`, in the same order; `DraftRefused` if none is possible.

    The profile uses the drives' current PDOs. With `configure` it uses new PDO maps that carry the objects
    needed, and CiA 301's identifiers; both are written into the drives at every connection.
    """
    drives = [node for node in nodes if node.drive]
    if not drives:
        raise DraftRefused(["no node on this bus is a CiA 402 servo drive by its 1000h"])
    pdos, obstacles = (_set_up, _configuration_obstacles) if configure else (_current, _obstacles)
    if reasons := [text for node in drives for text in obstacles(node)]:
        raise DraftRefused(reasons)
    supervisor = next((node.node for node in nodes if node.supervises), None)
    serials = [str(node.serial_number or f"node{node.node}") for node in drives]
    return BusProfile(
        name=name,
        joints=tuple(
            JointProfile(node=node.node, commands=pdos(node, RPDO), answers=pdos(node, TPDO))
            for node in drives
        ),
        configures_pdos=configure,
        supervisor=supervisor,
        serial_number="" if supervisor is not None else "-".join(serials),
        compared=frozenset.intersection(*(frozenset(node.described) for node in drives)),
    )


def _current(node: FoundNode, kind: PdoKind) -> tuple[Pdo, ...]:
    """Return usable current PDOs of a drive; each choice takes the PDO that adds the most objects still missing."""
    usable = [pdo for pdo in node.pdos if pdo.valid and pdo.kind is kind and not _unusable(pdo)]
    missing, chosen = set(kind.carried), list[DrivePdo]()
    while missing:
        best = max(usable, key=lambda pdo: len(missing & _carried(pdo)), default=None)
        if best is None or not missing & _carried(best):
            break
        chosen.append(best)
        missing -= _carried(best)
    return tuple(
        Pdo(number=pdo.number, cob_id=pdo.cob_id, entries=pdo.entries)
        for pdo in sorted(chosen, key=lambda pdo: pdo.number)
    )


def _carried(pdo: DrivePdo | Pdo) -> set[int]:
    return {
        index for index, sub, bits in pdo.entries if sub == 0 and bits in bus_profile.FIELD_BITS
    }


def _unusable(pdo: DrivePdo) -> str:
    kind = pdo.kind
    if pdo.transmission not in kind.transmission_types:
        required = f"{' or '.join(map(str, kind.transmission_types))} ({kind.transmission})"
        return f"is of transmission type {pdo.transmission}, not {required}"
    if any(bits % 8 for _, _, bits in pdo.entries):
        return "maps parts of bytes"
    if kind is RPDO:
        allowed = {*bus_profile.COMMAND_OBJECTS, *bus_profile.ZERO_OBJECTS}
        if others := [index for index, _, _ in pdo.entries if index not in allowed]:
            return f"carries {others[0]:04X}h, which this program cannot command"
    return ""


def _obstacles(node: FoundNode) -> Iterator[str]:
    if not any(pdo.valid for pdo in node.pdos):
        yield _read_problem(node)
        return
    for kind in (RPDO, TPDO):
        carried = {i for pdo in _current(node, kind) for i in _carried(pdo)}
        for index in kind.carried:
            if index in carried:
                continue
            reasons = [
                f"{kind.name}{pdo.number} {_unusable(pdo)}"
                for pdo in node.pdos
                if pdo.kind is kind and index in _carried(pdo)
            ]
            because = f" ({'; '.join(reasons)})" if reasons else ""
            yield f"node {node.node}: no usable {kind.name} carries {index:04X}h{because}"


def _read_problem(node: FoundNode) -> str:
    text = node.unread or next(iter(node.problems), "its PDOs could not be read")
    return text if text.lower().startswith(f"node {node.node}") else f"node {node.node}: {text}"


def _frames(node: FoundNode, kind: PdoKind) -> list[tuple[Entry, ...]]:
    frames, free_bits = list[tuple[Entry, ...]](), 0
    for index in kind.carried:
        entry = (index, 0, node.widths.get(index, 0))
        if entry[2] > free_bits:
            frames.append(())
            free_bits = FRAME_BITS
        frames[-1] = (*frames[-1], entry)
        free_bits -= entry[2]
    return frames


def _numbers(node: FoundNode, kind: PdoKind) -> list[int]:
    return [pdo.number for pdo in node.pdos if pdo.kind is kind]


def _set_up(node: FoundNode, kind: PdoKind) -> tuple[Pdo, ...]:
    pdos = zip(_numbers(node, kind), _frames(node, kind), strict=False)
    return tuple(
        Pdo(number=number, cob_id=kind.cob_id + COB_NEXT_PDO * at + node.node, entries=entries)
        for at, (number, entries) in enumerate(pdos)
    )


def _configuration_obstacles(node: FoundNode) -> Iterator[str]:
    if not node.widths:
        yield _read_problem(node)
        return
    needed_objects = (*bus_profile.COMMAND_OBJECTS, *bus_profile.FEEDBACK_OBJECTS)
    absent = [
        index for index in needed_objects if node.widths.get(index) not in bus_profile.FIELD_BITS
    ]
    yield from (f"node {node.node}: {index:04X}h cannot be read" for index in absent)
    if absent:  # how many frames are needed is not known
        return
    for kind in (RPDO, TPDO):
        needed, numbers = len(_frames(node, kind)), _numbers(node, kind)
        if len(numbers) < needed:
            yield f"node {node.node}: {needed} {kind.name}s are needed, but it has {len(numbers)}"
