"""Pages generated from code: YAML files, exit codes, keys of the terminal app, faults, object dictionary."""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any

from canopen.objectdictionary import ODVariable, datatypes

from hardware.canopen.objects import JOINT_PRODUCT, SUPERVISOR_PRODUCT
from hardware.eds import variables
from hardware.virtual.fault_messages import FAULTS, OPERATOR_SIDE, FaultDescription
from operator_app.config.any_file import FileKind, json_schema
from operator_app.config.resources import builtin_names, resolve
from operator_app.exit_codes import MEANING
from operator_app.manual.pages import table
from operator_app.session.ui.action_table import ACTIONS
from operator_app.session.ui.steps import Step
from operator_app.session.ui.user_interface import EVERYWHERE, Entry

EXAMPLES: Mapping[str, str] = {
    "arm": "sarcos_dextrous",
    "fixture": "hinge",
    "procedure": "hinge",
    "profile": "sarcos",
}
"""For each kind of file: the built-in file that its manual page shows in full; comments in it explain the keys."""

PURPOSE: Mapping[FileKind, str] = {
    "arm": "An arm file has the Denavit-Hartenberg table, the sensors and the ranges of an arm, and their "
    "uncertainties.",
    "fixture": "A fixture file describes the fixture between tool and table, and its placement.",
    "procedure": "A procedure file has the settings of `sarcal run`: arm, fixture, bus, modes, poses, limits.",
    "profile": "A bus profile states how the arm's CANopen nodes are set up. `sarcal probe --draft FILE` "
    "writes one.",
    "parameters": "A parameters file has the result of a calibration. `sarcal export` writes this file; do "
    "not edit it by hand.",
}


def _file_page(kind: FileKind) -> str:
    schema = json_schema(kind)
    models = schema["$defs"]
    tops = [choice["$ref"].rpartition("/")[2] for choice in schema["oneOf"]]
    title = "Bus profile" if kind == "profile" else f"{kind.capitalize()} file"
    return _page(
        f"# {title}",
        PURPOSE[kind],
        "YAML. Unknown keys, duplicate keys, wrong units and values that are not numbers are errors; all of them "
        "are listed at once, with file, line and key. A name ends in its unit: `_m`, `_mm`, `_deg`, `_mrad`, `_s`.",
        *(_example(kind) if kind in EXAMPLES else ()),
        *(
            block
            for name in dict.fromkeys((*tops, *models))
            for block in _model(name, models[name])
        ),
    )


def _page(*blocks: str) -> str:
    return "\n\n".join(blocks) + "\n"


def _example(kind: Any) -> Iterator[str]:
    yield f"Built-in: {', '.join(f'`{name}`' for name in builtin_names(kind))}."
    yield f"## The built-in {EXAMPLES[kind]}"
    yield f"```yaml\n{resolve(kind, EXAMPLES[kind]).data.decode().rstrip()}\n```"


def _model(name: str, model: Mapping[str, Any]) -> Iterator[str]:
    about, of_keys = _docstring(model.get("description", ""))
    required = model.get("required", ())
    rows = []
    for key, spec in model.get("properties", {}).items():
        default = "required" if key in required else _key_default(spec)
        meaning = spec.get("description") or of_keys.get(key, "")
        rows.append((f"`{key}`", _type(spec), default, meaning))
    yield f"## {heading(name)}"
    if about:
        yield about
    yield table(("key", "value", "default", "meaning"), rows)


def heading(model: str) -> str:
    """Return the name of a model as shown on the page: Rvdt for ``RvdtModel``."""
    bare = re.sub(r"(Model|Spec)$", "", model)
    name = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", bare).lower()
    return name[:1].upper() + name[1:]


def _docstring(text: str) -> tuple[str, dict[str, str]]:
    about, _, attributes = text.replace("``", "`").partition("Attributes\n----------\n")
    of_keys = {}
    listed = re.findall(r"^(\w[\w, ]*)\n((?:    .*\n?)+)", attributes, re.MULTILINE)
    for names, description in listed:
        of_keys.update({name.strip(): " ".join(description.split()) for name in names.split(",")})
    return " ".join(about.split()), of_keys


def _type(spec: Mapping[str, Any]) -> str:
    if "$ref" in spec:
        name = spec["$ref"].rpartition("/")[2]
        return f"see [{heading(name)}](#{heading(name).lower().replace(' ', '-')})"
    if "const" in spec:
        return f"`{spec['const']}`"
    if "enum" in spec:
        return " or ".join(f"`{value}`" for value in spec["enum"])
    if choices := spec.get("anyOf") or spec.get("oneOf"):
        return " or ".join(_type(c) for c in choices if c.get("type") != "null")
    match spec.get("type"):
        case "array" if "prefixItems" in spec:
            items = [_type(item) for item in spec["prefixItems"]]
            return f"{len(items)} of: {items[0]}"
        case "array":
            return f"list of: {_type(spec['items'])}"
        case "object":
            return f"mapping to: {_type(spec.get('additionalProperties') or {})}"
        case "number" | "integer" as number:
            return _number(spec, "number" if number == "number" else "whole number")
        case "boolean":
            return "true or false"
        case "string":
            return "text"
    return "anything"


def _number(spec: Mapping[str, Any], word: str) -> str:
    low, high = spec.get("minimum"), spec.get("maximum")
    above = spec.get("exclusiveMinimum")
    limit = "" if high is None else f" to {high:.10g}"
    if low is not None and limit:
        return f"{word}, {low:g}{limit}"
    if above is not None and (low is None or low <= above):
        return f"{word} above {above:g}{limit}"
    return f"{word}, at least {low:g}" if low is not None else word


def _key_default(spec: Mapping[str, Any]) -> str:
    default = spec.get("default")
    return "" if default is None or default == {} else f"`{json.dumps(default)}`"


TYPES = {
    getattr(datatypes, name): name
    for name in dir(datatypes)
    if name.isupper() and isinstance(getattr(datatypes, name), int)
}
"""Names of the data types of CiA 301."""


def _exit_codes_page() -> str:
    rows = [(f"`{int(code)}`", meaning) for code, meaning in MEANING.items()]
    return _page(
        "# Exit codes",
        "A script reads the exit code, not the text. The codes do not change between versions.",
        table(("code", "meaning"), rows),
        "Results go to stdout, progress and errors to stderr. `--json` prints one JSON document on stdout, and "
        "keeps the exit code.",
    )


def _keys_page() -> str:
    by_step = list[str]()
    for step in Step:
        own = [a for a in ACTIONS if step in a.steps and a.steps != EVERYWHERE]
        by_step += [f"## {int(step)} {step.title}", _keys(own)]
    return _page(
        "# Keys of the terminal app",
        "`?` explains the panel that has the focus and lists these keys. Ctrl+P finds every action by name. While "
        "the arm moves by itself, any key ends the motion. STOP is a software stop over the bus. It is not an "
        "emergency stop.",
        "## Everywhere",
        _keys(a for a in ACTIONS if a.steps == EVERYWHERE),
        *by_step,
    )


def _keys(actions: Iterable[Entry]) -> str:
    rows = [(f"`{a.shown}`" if a.shown else "", a.label, a.help) for a in actions]
    return table(("key", "action", "what it does"), rows)


def faults_page() -> str:
    """Return the page of faults that can be injected."""
    head = ("fault", "what is broken", "the operator", "the arm", "what is kept", "what to do")
    at_connect = ", ".join(f"`{name}`" for name, fault in FAULTS.items() if fault.at_connect)
    return _page(
        "# Faults",
        "What can go wrong on the bus and in the arm, what is reported, and what to do. `sarcal controller "
        "--fault NAME` produces each fault of the first table on the virtual controller. J is the number of the "
        f"joint. A fault that shows while an arm is being connected ({at_connect}) is present from the start; the "
        "others begin after 1000 SYNCs. `--fault-sync N` changes that; 0 is from the start. An upload that meets "
        "a fault either completes, or the parameters that were active stay active.",
        table(head, ((f"`{name}`", *_fault(fault)) for name, fault in FAULTS.items())),
        "## Where the operator sits",
        table(head, ((name, *_fault(fault)) for name, fault in OPERATOR_SIDE.items())),
    )


def _fault(fault: FaultDescription) -> tuple[str, ...]:
    return fault.broken, fault.symptom(), fault.does(), fault.kept, fault.remedy


def _objects_page() -> str:
    head = ("object", "name", "type", "access", "default")
    return _page(
        "# Object dictionary",
        "The virtual joint drive and the supervisor, from their EDS files. `sarcal eds` writes these for other "
        "CANopen tools. Joint j is node j, the supervisor node 16. CiA 301 and CiA 402 define the objects up to "
        "1FFFh and from 6000h; 2000h to 2FFFh are our own. Positions are counts of the joint's sensor. 607Ch "
        "keeps `theta_off` in the same counts; it never shifts what 6064h reports.",
        "## Joint drive",
        table(head, _objects(JOINT_PRODUCT)),
        "## Supervisor",
        table(head, _objects(SUPERVISOR_PRODUCT)),
    )


def _objects(product: int) -> Iterator[tuple[str, ...]]:
    for (index, sub), entry in sorted(variables(product, 0).items()):
        place = f"{index:04X}h sub {sub}" if sub else f"{index:04X}h"
        parent = getattr(entry.parent, "name", "")
        name = f"{parent}: {entry.name}" if parent else entry.name
        kind = TYPES.get(int(entry.data_type or 0), "").replace("_", " ").lower()
        yield f"`{place}`", name, kind, entry.access_type, _default(entry)


def _default(entry: ODVariable) -> str:
    value: object = entry.default  # annotated as int by canopen, but an EDS also has texts
    if value is None:
        return ""
    node = "node + " if entry.relative else ""
    if isinstance(value, int) and (value > 0xFFF or "COB-ID" in entry.name):
        return f"{node}{value:X}h"
    return f"{node}{value}"


PAGES: Mapping[str, Callable[[], str]] = {
    **{f"{kind}-file": partial(_file_page, kind) for kind in PURPOSE},
    "exit-codes": _exit_codes_page,
    "keys": _keys_page,
    "faults": faults_page,
    "objects": _objects_page,
}
