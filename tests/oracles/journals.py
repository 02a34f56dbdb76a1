"""Journals written without the product's writer, and changed at random with their checksums put right."""

import copy
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from random import Random
from typing import Any

from operator_app.session.store.journal_format import JournalEvent

Named = tuple[str, dict[str, Any]]

POSE = {
    "waypoint": 0, "sd_rad": [1e-5] * 7, "samples": 8, "first_sync": 12, "note": "",
}  # fmt: skip
WORDS = ("procedure", "arm", "fixture")


def an_event(name: str, data: dict[str, Any]) -> JournalEvent:
    return JournalEvent(seq=1, utc="2026-11-22T10:00:00Z", name=name, data=data)


def sources() -> dict[str, str]:
    """The packaged documents."""
    root = Path(__file__).parents[2]
    folders = {
        "procedure": root / "operator_app/data/procedures/hinge.yaml",
        "arm": root / "operator_app/data/arms/sarcos_dextrous.yaml",
        "fixture": root / "fixtures/data/hinge.yaml",
    }
    return {kind: folders[kind].read_text(encoding="utf-8") for kind in WORDS}


def events() -> list[Named]:
    """One of every event that a session reads again, in an order that can be."""
    q = [0.1, -0.2, 0.3, 1.4, -0.5, 0.6, 0.7]
    settings = {
        "poses": 3, "plan": None, "estimator": None, "unsensed_joints": None,
        "length_tolerance_m": None, "upload": None, "interface": "virtual", "channel": None,
        "bitrate": None, "scenario": "exact", "seed": 0,
    }  # fmt: skip
    node = {
        "node": 1, "role": "joint 1", "device_name": "virtual joint", "vendor_id": 0,
        "product_code": 1, "revision": 1, "serial_number": 1001,
    }  # fmt: skip
    reading = {"mean_rad": q, "sd_rad": [0.0] * 7, "samples": 8, "first_sync": 99}
    return [
        ("opened", {"sources": sources(), "settings": settings}),
        ("connected", {"model": "sarcos_dextrous", "serial_number": "SDA-0001", "nodes": [node]}),
        ("fixture_checked", {"checks": [{"severity": "ok", "text": "fine", "remedy": ""}]}),
        ("control", {"start_rad": q}),
        ("drives_chosen", {"drives": [1, 5], "sets": [[1, 5], [2, 5]], "reasons": ["r"]}),
        ("modes", {"modes": ["position", *["free"] * 3, "position", "free", "free"]}),
        ("pose", {"number": 1, "mean_rad": q, **POSE}),
        ("waypoint_skipped", {"waypoint": 1, "reason": "joint 4 at its end"}),
        ("pose", {"number": 2, "mean_rad": [-v for v in q], **POSE, "waypoint": 2}),
        ("pose_noted", {"number": 2, "text": "cable?"}),
        ("pose_excluded", {"number": 2, "text": "by the operator"}),
        ("pose_included", {"number": 2}),
        ("pose", {"number": 3, "mean_rad": q, **POSE, "waypoint": 3}),
        ("pose_undone", {"number": 3}),
        ("pose_restored", {"number": 3}),
        ("pose_undone", {"number": 3}),
        ("reading", {"number": 1, "kind": "return", "of": 1, **reading}),
        ("campaign", {
            "poses": 3, "requested": {"theta_off_1": 0.001}, "unsensed_joints": [], "samples": 8,
            "seed": 0, "candidates": 10, "drive_sets": [[1, 5]], "start_rad": q, "at_rad": q,
            "captured": [1, 2],
        }),
        ("campaign_move", {"targets_rad": {"1": 0.2, "5": -0.4}, "why": "", "q_rad": q, "stopped": ""}),
        ("campaign_drives", {"drives": [2, 5], "q_rad": q}),
        ("pose", {"number": 4, "mean_rad": q, **POSE, "waypoint": -1, "planned": True}),
        ("campaign_ended", {
            "complete": True, "text": "done",
            "weak": [{"name": "a_0", "sigma": None, "requested": 0.1}],
        }),
        ("solved", {
            "estimator": "implicit", "unsensed_joints": [], "length_tolerance_m": None,
            "poses": [1, 2, 4], "rereads": 1, "parameters": {"theta_off_1": 0.17},
            "scaled_condition_number": 35.0, "accepted": True, "record": {"version": 0},
        }),
        ("checked", {"record": {"version": 0}}),
        ("exported", {
            "file": "parameters.yaml", "sha256": "00", "forced": "",
            "uploaded": {"slot": "A", "length": 10, "sha256": "00"},
        }),
        ("reading", {"number": 2, "kind": "verification", "of": 0, **reading}),
        ("verified", {"poses": 1, "readings": [2], "position_m": 0.001, "holds": True}),
        ("confirmed", {"item": "stop", "text": "tested"}),
        ("resumed", {"settings": settings}),
        ("closed", {"reason": "done"}),
    ]  # fmt: skip


def written(
    found: Sequence[Named], *, utc: Callable[[int], Any] | None = None, version: bool = True
) -> bytes:
    """A journal of these events, checksums right."""
    chain, lines = "", []
    for number, (name, data) in enumerate(found, 1):
        record: dict[str, Any] = {"schema": "sarcal/journal/1"} if version and number == 1 else {}
        stamp = f"2026-01-31T12:{number // 60:02d}:{number % 60:02d}.000Z"
        record |= {"seq": number, "utc": stamp, "event": name, "data": data}
        if utc is not None:
            record["utc"] = utc(number)
        body = json.dumps(record, ensure_ascii=True, separators=(",", ":"))
        chain = hashlib.sha256((chain + body).encode()).hexdigest()[:16]
        lines.append(f'{body[:-1]},"sum":"{chain}"}}\n')
    return "".join(lines).encode()


ODD: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 7, 8, 1e30, 10**30, -(10**30), 2**63, 1e-300, -1e300, 1e308,
    float("nan"), float("inf"), float("-inf"), "", "x", "1", "NaN", "\x1b[2J", "\u202e", "a\nb",
    "\ud800", "A" * 10_000, [], [[]], [1], [0.1] * 6, [0.1] * 8, ["a"] * 7, [None] * 7, [[0.1] * 7],
    [float("nan")] * 7, [1e30] * 7, {}, {"a": 1}, {"1": {}}, {"99": 0.1}, {"-1": 0.1},
    {"\u0661": 1.0}, "2026-13-99T99:99:99.000Z", "0000-00-00T00:00:00Z", "../../etc/passwd",
)  # fmt: skip


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Where something stands in a document: paths of keys and indices."""
    found = [path] if path else []
    if isinstance(value, Mapping):
        for key in value:
            found += places(value[key], (*path, key))
    elif isinstance(value, list):
        for k, item in enumerate(value):
            found += places(item, (*path, k))
    return found


def mutated(document: Any, rng: Random) -> Any:
    """A document with one thing in it another than it was."""
    document = copy.deepcopy(document)
    paths = places(document)
    if not paths:
        return rng.choice(ODD)
    *above, last = rng.choice(paths)
    within = document
    for key in above:
        within = within[key]
    match rng.randrange(6):
        case 0:
            del within[last]
        case 1 if isinstance(within, list):
            within.insert(last, copy.deepcopy(within[last]))
        case 2 if isinstance(within, dict):
            within[rng.choice(("x", "", "sum", last + "_"))] = within.pop(last)
        case 3 if isinstance(within[last], int | float) and not isinstance(within[last], bool):
            within[last] *= rng.choice((-1, 0, 2, 1e9, 1e200, 0.5))
        case _:
            within[last] = copy.deepcopy(rng.choice(ODD))
    return document


def mutated_journal(rng: Random) -> bytes:
    """A journal with checksums that are right, and contents that are not."""
    found = events()
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        at = rng.randrange(len(found))
        match rng.randrange(10):
            case 0:
                del found[at]
            case 1:
                found.insert(at, copy.deepcopy(rng.choice(found)))
            case 2:
                found[at] = (rng.choice((found[at][0].upper(), "", "later", "\x1b")), found[at][1])
            case 3:
                found[at] = (rng.choice(found)[0], found[at][1])
            case _:
                found[at] = (found[at][0], mutated(found[at][1], rng))
        if not found:
            found = events()
    odd = rng.randrange(len(found)) + 1 if rng.random() < 0.05 else 0
    stamp = rng.choice(ODD)
    return written(
        found, utc=lambda k: stamp if k == odd else "2026-01-31T12:00:00.000Z",
        version=rng.random() < 0.8,
    )  # fmt: skip
