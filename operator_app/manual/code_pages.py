"""Pages that are lists in the code: exit codes, keys of the terminal app, faults, object dictionary."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from canopen.objectdictionary import ODVariable, datatypes

from hardware.canopen.objects import JOINT_PRODUCT
from hardware.eds import EDS_FILES, product_dictionary, variables
from hardware.virtual.fault_messages import FAULTS, FaultDescription
from hardware.virtual.operator_side import OPERATOR_SIDE
from operator_app.exit_codes import MEANING
from operator_app.manual.markup import table
from operator_app.session.ui.actions import ACTIONS
from operator_app.session.ui.steps import Step
from operator_app.session.ui.user_interface import EVERYWHERE, Entry

TYPES = {
    getattr(datatypes, name): name
    for name in dir(datatypes)
    if name.isupper() and isinstance(getattr(datatypes, name), int)
}
"""Names of the data types of CiA 301."""


def exit_codes_page() -> str:
    """Return the page of exit codes."""
    rows = [(f"`{int(code)}`", meaning) for code, meaning in MEANING.items()]
    return "\n\n".join(
        (
            "# Exit codes",
            "A script reads the exit code, not the text. The codes do not change between versions.",
            table(("code", "meaning"), rows),
            (
                "Results go to stdout, progress and errors to stderr. `--json` prints one object on stdout, "
                "and keeps the exit code.\n"
            ),
        )
    )


def keys_page() -> str:
    """Return the page of keys, step by step."""
    blocks = [
        "# Keys of the terminal app",
        (
            "`?` explains the panel that has the focus and lists these keys. Ctrl+P finds every action by "
            "name. While the arm moves by itself, any key ends the motion. STOP is a software stop over the "
            "bus. It is not an emergency stop."
        ),
        "## Everywhere",
        _keys(a for a in ACTIONS if a.steps == EVERYWHERE),
    ]
    for step in Step:
        own = [a for a in ACTIONS if step in a.steps and a.steps != EVERYWHERE]
        blocks += [f"## {int(step)} {step.title}", _keys(own)]
    return "\n\n".join(blocks) + "\n"


def _keys(actions: Iterable[Entry]) -> str:
    rows = [(f"`{a.shown}`" if a.shown else "", a.label, a.help) for a in actions]
    return table(("key", "action", "what it does"), rows)


def faults_page() -> str:
    """Return the page of faults that can be made on purpose."""
    head = ("fault", "what is broken", "the operator", "the arm", "what is kept", "what to do")
    return "\n\n".join(
        (
            "# Faults",
            (
                "What can go wrong on the bus and in the arm, what is reported, and what to do. `sarcal "
                "controller --fault NAME` produces each fault of the first table on the virtual controller. J is "
                "the number of the joint. A fault that shows while an arm is being connected "
                f"({', '.join(f'`{name}`' for name, fault in FAULTS.items() if fault.at_connect)}) is present from "
                "the start; the others begin after 1000 SYNCs. `--fault-sync N` changes that; 0 is from the start. "
                "An upload that meets a fault either completes, or the parameters that were active stay active."
            ),
            table(head, _faults(FAULTS)),
            "## Where the operator sits",
            table(head, _faults(OPERATOR_SIDE, code=False)) + "\n",
        )
    )


def _faults(faults: Mapping[str, FaultDescription], *, code: bool = True) -> list[tuple[str, ...]]:
    return [
        (
            f"`{name}`" if code else name,
            *(fault.broken, fault.seen(), fault.does(), fault.kept, fault.remedy),
        )
        for name, fault in faults.items()
    ]


def objects_page() -> str:
    """Return the object dictionaries of joint drive and supervisor."""
    blocks = [
        "# Object dictionary",
        (
            "The virtual joint drive and the supervisor, from their EDS files. `sarcal eds` writes these for "
            "other CANopen tools. Joint j is node j, the supervisor node 16. CiA 301 and CiA 402 define the "
            "objects up to 1FFFh and from 6000h; 2000h to 2FFFh are our own. Positions are counts of the "
            "joint's sensor. 607Ch keeps `theta_off` in the same counts; it never shifts what 6064h reports."
        ),
    ]
    for product in EDS_FILES:
        title = "Joint drive" if product == JOINT_PRODUCT else "Supervisor"
        head = ("object", "name", "type", "access", "default")
        blocks += [f"## {title}", table(head, _objects(product))]
    return "\n\n".join(blocks) + "\n"


def _objects(product: int) -> Iterator[tuple[str, ...]]:
    entries = variables(product_dictionary(product, 0))
    for (index, sub), entry in sorted(entries.items()):
        place = f"{index:04X}h sub {sub}" if sub else f"{index:04X}h"
        kind = TYPES.get(int(entry.data_type or 0), "").replace("_", " ").lower()
        yield f"`{place}`", _name(entry), kind, entry.access_type, _default(entry)


def _name(entry: ODVariable) -> str:
    parent = getattr(entry.parent, "name", "")
    return f"{parent}: {entry.name}" if parent else entry.name


def _default(entry: ODVariable) -> str:
    value: object = entry.default  # canopen says int; an EDS has texts too
    if value is None:
        return ""
    node = "node + " if entry.relative else ""
    if isinstance(value, int) and (value > 0xFFF or "COB-ID" in entry.name):
        return f"{node}{value:X}h"
    return f"{node}{value}"
