"""Journals from a second writer, and random mutations of them with correct checksums."""

import copy
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from random import Random
from typing import Any

from operator_app.config.resources import resolve
from operator_app.session.store.journal import JOURNAL_NAME
from operator_app.session.store.journal_format import JournalEvent

Named = tuple[str, dict[str, Any]]

POSE = {
    "waypoint": 0, "sd_rad": [1e-5] * 7, "samples": 8, "first_sync": 12, "note": "",
}  # fmt: skip


def journal_event(name: str, data: dict[str, Any]) -> JournalEvent:
    return JournalEvent(seq=1, utc="2026-11-22T10:00:00Z", name=name, data=data)


def sources() -> dict[str, str]:
    names = {"procedure": "hinge", "arm": "sarcos_dextrous", "fixture": "hinge"}
    return {kind: resolve(kind, name).data.decode() for kind, name in names.items()}


def events() -> list[Named]:
    """One of each event that a resumed session reads, in a possible order."""
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
    entries: Sequence[Named], *, utc: Callable[[int], Any] | None = None, version: bool = True
) -> bytes:
    """A journal of these events with correct checksums."""
    chain, lines = "", []
    for number, (name, data) in enumerate(entries, 1):
        record: dict[str, Any] = {"schema": "sarcal/journal/1"} if version and number == 1 else {}
        stamp = f"2026-01-31T12:{number // 60:02d}:{number % 60:02d}.000Z"
        record |= {"seq": number, "utc": utc(number) if utc else stamp, "event": name, "data": data}
        body = json.dumps(record, ensure_ascii=True, separators=(",", ":"))
        chain = hashlib.sha256((chain + body).encode()).hexdigest()[:16]
        lines.append(f'{body[:-1]},"sum":"{chain}"}}\n')
    return "".join(lines).encode()


def write_journal(folder: Path, raw: bytes) -> Path:
    """Write a journal into a session folder, made if necessary; return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / JOURNAL_NAME).write_bytes(raw)
    return folder


ODD: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 7, 8, 1e30, 10**30, -(10**30), 2**63, 1e-300, -1e300, 1e308,
    float("nan"), float("inf"), float("-inf"), "", "x", "1", "NaN", "\x1b[2J", "\u202e", "a\nb",
    "\ud800", "A" * 10_000, [], [[]], [1], [0.1] * 6, [0.1] * 8, ["a"] * 7, [None] * 7, [[0.1] * 7],
    [float("nan")] * 7, [1e30] * 7, {}, {"a": 1}, {"1": {}}, {"99": 0.1}, {"-1": 0.1},
    {"\u0661": 1.0}, "2026-13-99T99:99:99.000Z", "0000-00-00T00:00:00Z", "../../etc/passwd",
)  # fmt: skip


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of keys and indices of every item of a document."""
    paths = [path] if path else []
    if isinstance(value, Mapping):
        for key in value:
            paths += places(value[key], (*path, key))
    elif isinstance(value, list):
        for k, item in enumerate(value):
            paths += places(item, (*path, k))
    return paths


def mutated(document: Any, rng: Random) -> Any:
    """A document with one random change."""
    document = copy.deepcopy(document)
    paths = places(document)
    if not paths:
        return rng.choice(ODD)
    *parents, last = rng.choice(paths)
    parent = document
    for key in parents:
        parent = parent[key]
    match rng.randrange(6):
        case 0:
            del parent[last]
        case 1 if isinstance(parent, list):
            parent.insert(last, copy.deepcopy(parent[last]))
        case 2 if isinstance(parent, dict):
            parent[rng.choice(("x", "", "sum", last + "_"))] = parent.pop(last)
        case 3 if isinstance(parent[last], int | float) and not isinstance(parent[last], bool):
            parent[last] *= rng.choice((-1, 0, 2, 1e9, 1e200, 0.5))
        case _:
            parent[last] = copy.deepcopy(rng.choice(ODD))
    return document


def mutated_journal(rng: Random) -> bytes:
    """A journal with random changes and correct checksums."""
    entries = events()
    for _ in range(rng.choice((1, 1, 1, 2, 5))):
        at = rng.randrange(len(entries))
        match rng.randrange(10):
            case 0:
                del entries[at]
            case 1:
                entries.insert(at, copy.deepcopy(rng.choice(entries)))
            case 2:
                entries[at] = (
                    rng.choice((entries[at][0].upper(), "", "later", "\x1b")),
                    entries[at][1],
                )
            case 3:
                entries[at] = (rng.choice(entries)[0], entries[at][1])
            case _:
                entries[at] = (entries[at][0], mutated(entries[at][1], rng))
        if not entries:
            entries = events()
    odd_line = rng.randrange(len(entries)) + 1 if rng.random() < 0.05 else 0
    stamp = rng.choice(ODD)
    return written(
        entries, utc=lambda k: stamp if k == odd_line else "2026-01-31T12:00:00.000Z",
        version=rng.random() < 0.8,
    )  # fmt: skip
