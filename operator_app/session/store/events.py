"""What the events of a journal may say: every key that is read from one is looked at here first.

A line can be whole to the last bit and still say what no session can mean: written by another version,
or by hand. Returns words about the first thing that is wrong, and where. Knows no file and no arm.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from datetime import datetime
from typing import Any

from hardware.virtual import SCENARIOS

Check = Callable[[Any, int | None], str]
"""Given a value and the number of joints (None while no event has told it): what is wrong, or ""."""

MOST = 2**53
"""Whole numbers beyond are none that a double, or an array, can hold."""
LARGEST_RAD = 20.0 * math.pi
"""As in a poses file: sensor angles may exceed a turn, but not ten."""
MOST_JOINTS = 100
UTC = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d{1,9})?Z")


def problem_of(name: str, data: Mapping[str, Any], utc: str, joints: int | None) -> tuple[str, str]:
    """Return the key that is wrong in an event, and what is wrong with it; both empty when nothing is."""
    if not _is_time(utc):
        return "utc", f"{_shown(utc)} is no time such as 2026-01-31T12:00:00.000Z"
    for key, check in EVENTS.get(name, {}).items():
        wanted = key.rstrip("?")
        if wanted not in data:
            if key == wanted:
                return wanted, "is missing"
            continue
        problem = check(data[wanted], joints)
        if problem:
            return wanted, problem
    return "", ""


def joints_told(name: str, data: Mapping[str, Any]) -> int | None:
    """Return how many joints an event that was checked speaks of; None where it says nothing of it."""
    for key in EVENTS.get(name, {}):
        if key in OF_EVERY_JOINT and key in data:
            return len(data[key])
    return None


def _is_time(utc: str) -> bool:
    try:
        return bool(UTC.fullmatch(utc)) and bool(datetime.fromisoformat(utc))
    except ValueError:
        return False


# -- what a value may be -------------------------------------------------------------------------


def whole(least: int, most: int = MOST) -> Check:
    """Accept a whole number from `least` to `most`."""

    def check(value: Any, _: int | None) -> str:
        if type(value) is not int:
            return f"must be a whole number, not {_shown(value)}"
        return "" if least <= value <= most else f"{_shown(value)} is not {least} or more"

    return check


def number(least: float = -1e300, most: float = 1e300) -> Check:
    """Accept a number within bounds."""

    def check(value: Any, _: int | None) -> str:
        if type(value) not in (int, float):
            return f"must be a number, not {_shown(value)}"
        return "" if least <= value <= most else f"{_shown(value)} is not a number that can be"

    return check


def text(value: Any, _: int | None) -> str:
    """Accept text."""
    return "" if isinstance(value, str) else f"must be text, not {_shown(value)}"


def yes_or_no(value: Any, _: int | None) -> str:
    """Accept true or false."""
    return "" if isinstance(value, bool) else f"must be true or false, not {_shown(value)}"


def joint(value: Any, joints: int | None) -> str:
    """Accept the number of a joint."""
    most = joints or MOST_JOINTS
    problem = whole(1)(value, joints)
    return problem or ("" if value <= most else f"there is no joint {_shown(value)}, of {most}")


def joint_key(value: Any, joints: int | None) -> str:
    """Accept the number of a joint as JSON has it for a key."""
    known = isinstance(value, str) and re.fullmatch(r"[1-9]\d{0,2}", value)
    return joint(int(value), joints) if known else f"{_shown(value)} is no joint"


def one_of(*words: str) -> Check:
    """Accept one of these words."""

    def check(value: Any, _: int | None) -> str:
        if isinstance(value, str) and value in words:
            return ""
        return f"{_shown(value)} is none of {', '.join(words)}"

    return check


def nothing_or(other: Check) -> Check:
    """Accept null, or what `other` accepts."""
    return lambda value, joints: "" if value is None else other(value, joints)


def many(item: Check) -> Check:
    """Accept a list of such items."""

    def check(value: Any, joints: int | None) -> str:
        if not isinstance(value, list):
            return f"must be a list, not {_shown(value)}"
        found = (f"item {k}: {p}" for k, v in enumerate(value, 1) if (p := item(v, joints)))
        return next(found, "")

    return check


def of_joints(item: Check) -> Check:
    """Accept a list of one such item a joint."""

    def check(value: Any, joints: int | None) -> str:
        problem = many(item)(value, joints)
        if problem:
            return problem
        if joints is not None and len(value) != joints:
            return f"has {len(value)} items, one for each of {joints} joints is wanted"
        return "" if 1 <= len(value) <= MOST_JOINTS else f"has {len(value)} items"

    return check


def measured(value: Any, joints: int | None) -> str:
    """Accept a measured endpoint: a point, or a point and how it is turned."""
    problem = many(ANGLE)(value, joints)
    return problem or ("" if len(value) in (3, 6) else f"has {len(value)} items, 3 or 6 are wanted")


def keyed(key: Check, item: Check) -> Check:
    """Accept an object of such keys and values."""

    def check(value: Any, joints: int | None) -> str:
        if not isinstance(value, dict):
            return f"must be an object, not {_shown(value)}"
        for name, found in value.items():
            problem = key(name, joints) or item(found, joints)
            if problem:
                return f"{_shown(name)}: {problem}"
        return ""

    return check


def fields(**known: Check) -> Check:
    """Accept an object with these keys, and any others; a name that ends in ``_0`` may be missing."""

    def check(value: Any, joints: int | None) -> str:
        if not isinstance(value, dict):
            return f"must be an object, not {_shown(value)}"
        for name, item in known.items():
            wanted = name.removesuffix("_0")
            if wanted not in value:
                if wanted == name:
                    return f"{wanted} is missing"
                continue
            problem = item(value[wanted], joints)
            if problem:
                return f"{wanted}: {problem}"
        return ""

    return check


def anything(_: Any, __: int | None) -> str:
    """Accept what nobody reads."""
    return ""


def _shown(value: Any) -> str:
    """Return a value as part of a sentence, in a few words."""
    match value:
        case None:
            return "null"
        case bool():
            return "true" if value else "false"
        case int() if abs(value) > MOST:
            return "a number of too many digits"
        case int() | float():
            return f"{value}"
        case str():
            return ascii(value[:40])
        case list():
            return "a list"
        case _:
            return "an object"


# -- the events ----------------------------------------------------------------------------------

ANGLE = number(-LARGEST_RAD, LARGEST_RAD)
ANGLES = of_joints(ANGLE)
SPREADS = of_joints(number(0.0, LARGEST_RAD))
COUNT = whole(1)
JOINTS = many(joint)
SECONDS = number(0.0)
OBJECT = keyed(text, anything)

SETTINGS = fields(
    poses_0=nothing_or(COUNT),
    plan_0=nothing_or(one_of("explore", "planned")),
    estimator_0=nothing_or(one_of("implicit", "paper")),
    unsensed_joints_0=nothing_or(JOINTS),
    length_tolerance_m_0=nothing_or(number(0.0, 10.0)),
    upload_0=nothing_or(yes_or_no),
    interface_0=nothing_or(text),
    channel_0=nothing_or(text),
    bitrate_0=nothing_or(COUNT),
    profile_0=nothing_or(text),
    scenario_0=nothing_or(one_of(*SCENARIOS)),
    seed_0=nothing_or(whole(0)),
    tracker_0=nothing_or(text),
    operator_0=nothing_or(text),
    placements_0=nothing_or(COUNT),
    verifies_0=text,
    drop_unidentifiable_0=nothing_or(yes_or_no),
)
NODE = fields(node=whole(0, 127), serial_number=whole(0), device_name_0=text)
RECEIPT = fields(slot=text, length=whole(0), sha256=text)
WEAK = fields(name=text, sigma=nothing_or(number(0.0)), requested=number(0.0))

OF_EVERY_JOINT = ("start_rad", "mean_rad", "sd_rad", "modes", "at_rad", "q_rad")

EVENTS: Mapping[str, Mapping[str, Check]] = {
    "opened": {"sources": keyed(text, text), "settings": SETTINGS, "after?": text},
    "resumed": {"settings": SETTINGS},
    "imported": {"file": text, "serial_number": text},
    "connected": {
        "serial_number": text,
        "model?": text,
        "nodes?": many(NODE),
        "configured?": many(text),
    },
    "reset": {"joints?": JOINTS, "code?": whole(0)},
    "sensor_fault": {"joint": joint, "text": text},
    "late": {"times": COUNT, "last_s": SECONDS, "longest_s": SECONDS},
    "return_holds": {"of?": whole(0)},
    "standing": {
        "told?": text,
        "probability?": nothing_or(number(0.0, 1.0)),
        "refused?": yes_or_no,
    },
    "control": {"start_rad": ANGLES, "home_rad?": ANGLES},
    "modes": {"modes": of_joints(one_of("position", "free"))},
    "remounting": {"placement": whole(2)},
    "remounted": {"placement": whole(2)},
    "went_home": {"joints": JOINTS, "q_rad": ANGLES, "stopped?": text},
    "waypoint_skipped": {"waypoint": whole(0), "reason?": text},
    "pose": {
        "number": COUNT,
        "waypoint": whole(-1),
        "mean_rad": ANGLES,
        "sd_rad": SPREADS,
        "samples": COUNT,
        "note?": text,
        "planned?": yes_or_no,
        "first_sync?": whole(0),
        "placement?": COUNT,
        "endpoint?": measured,
        "taken_utc?": text,
    },
    "reading": {
        "number": COUNT,
        "kind": text,
        "mean_rad": ANGLES,
        "sd_rad": SPREADS,
        "samples": COUNT,
        "of?": whole(0),
        "placement?": COUNT,
        "endpoint?": measured,
    },
    "pose_undone": {"number": COUNT},
    "pose_restored": {"number": COUNT},
    "pose_excluded": {"number": COUNT, "text": text},
    "pose_included": {"number": COUNT},
    "pose_noted": {"number": COUNT, "text": text},
    "drives_chosen": {"drives": JOINTS, "sets": many(JOINTS)},
    "campaign": {
        "poses": whole(0),
        "requested": keyed(text, number(0.0)),
        "unsensed_joints": JOINTS,
        "samples": COUNT,
        "seed": whole(0),
        "candidates": COUNT,
        "drive_sets": many(JOINTS),
        "start_rad": ANGLES,
        "at_rad": ANGLES,
        "captured": many(COUNT),
    },
    "campaign_move": {"targets_rad": keyed(joint_key, ANGLE), "q_rad": ANGLES, "stopped?": text},
    "campaign_drives": {"drives": JOINTS, "q_rad": ANGLES},
    "campaign_ended": {"complete": yes_or_no, "text": text, "weak": many(WEAK)},
    "solved": {
        "estimator?": one_of("implicit", "paper"),
        "unsensed_joints?": JOINTS,
        "length_tolerance_m?": nothing_or(number(0.0, 10.0)),
        "poses?": many(COUNT),
        "rereads?": whole(0),
        "parameters?": keyed(text, number()),
        "scaled_condition_number?": number(),
        "accepted": yes_or_no,
        "record?": OBJECT,
        "made_with?": keyed(text, text),
    },
    "checked": {"record": OBJECT},
    "exported": {
        "file": text,
        "uploaded": nothing_or(RECEIPT),
        "sha256?": text,
        "forced?": text,
        "unknown?": text,
    },
    "return_missed": {"of?": whole(0), "reason?": text},
    "repaired": {"lost": many(whole(1)), "original?": text},
    "closed": {"reason?": text},
}
"""Keys that are read from each event; one with a question mark may be missing. Others are not looked at."""
