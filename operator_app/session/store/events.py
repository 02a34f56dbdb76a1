"""Checks the data of journal events: keys, types and limits. Returns the first problem as text.

A line with a valid checksum can still contain data that no session can use, if another version of the program or a
person wrote it.
"""

import math
import re
from collections.abc import Callable, Mapping
from datetime import datetime
from typing import Any

from hardware.virtual import SCENARIOS
from operator_app.session.store.journal_format import JournalEvent
from operator_app.units import MOST_WHOLE

Check = Callable[[Any, int | None], str]
"""Function of a value and the number of joints (None if not known yet); returns the problem as text, "" if valid."""

MAX_ANGLE_RAD = 20.0 * math.pi
"""Limit of sensor angles, as in a poses file: they may exceed one turn, but not ten."""
MOST_JOINTS_RECORDED = 100
UTC = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d{1,9})?Z")


def event_problem(event: JournalEvent, joints: int | None, captured: int = 0) -> tuple[str, str]:
    """Return the first invalid key of an event and the problem with its value, or ("", "") if it is valid.

    `joints`: number of joints, None if not known yet. `captured`: number of the last pose captured before the event.
    """
    if not _is_time(event.utc):
        return "utc", f"{_quoted(event.utc)} is not a time such as 2026-01-31T12:00:00.000Z"
    key, problem = _first_problem(EVENTS.get(event.name, {}), event.data, joints)
    if not problem and event.name == "pose" and event.data["number"] <= captured:
        number = event.data["number"]
        when = "twice" if number == captured else f"after pose {captured}"
        return "number", f"pose {number} is recorded {when}"
    return key, problem


def joint_count_in(event: JournalEvent) -> int | None:
    """Return the number of joints in a valid event; None if it has no list with a value for each joint."""
    keys = EVENTS.get(event.name, {})
    return next((len(event.data[k]) for k in keys if k in PER_JOINT and k in event.data), None)


def _first_problem(
    checks: Mapping[str, Check], data: Mapping[str, Any], joints: int | None
) -> tuple[str, str]:
    for key, check in checks.items():
        name = key.removesuffix("?")
        if name in data:
            if problem := check(data[name], joints):
                return name, problem
        elif key == name:
            return name, "is missing"
    return "", ""


def _is_time(utc: str) -> bool:
    try:
        return bool(UTC.fullmatch(utc)) and bool(datetime.fromisoformat(utc))
    except ValueError:
        return False


# -- checks of one value -------------------------------------------------------------------------


def of_type(what: str, *types: type) -> Check:
    """Return a check for a value of one of these types; the problem text calls the types `what`."""
    return lambda value, _: "" if type(value) in types else f"must be {what}, not {_quoted(value)}"


def both(first: Check, second: Check) -> Check:
    """Return a check that accepts what both checks accept; `second` gets only values that `first` accepts."""
    return lambda value, joints: first(value, joints) or second(value, joints)


def between(least: float, most: float) -> Check:
    """Return a check for a value from `least` to `most`."""

    def check(value: Any, _: int | None) -> str:
        if value < least:
            return f"{_quoted(value)} is less than {least:g}"
        # NaN fails this comparison too.
        return "" if value <= most else f"{_quoted(value)} is more than {most:g}"

    return check


def integer(least: int, most: int = MOST_WHOLE) -> Check:
    """Return a check for an integer from `least` to `most`."""
    return both(of_type("a whole number", int), between(least, most))


def number(least: float = -1e300, most: float = 1e300) -> Check:
    """Return a check for a number from `least` to `most`."""
    return both(of_type("a number", int, float), between(least, most))


text = of_type("text", str)
boolean = of_type("true or false", bool)
a_list = of_type("a list", list)
an_object = of_type("an object", dict)


def joint_number(value: Any, joints: int | None) -> str:
    """Check the number of a joint (from 1); return the problem as text, "" if the number is valid."""
    most = joints or MOST_JOINTS_RECORDED
    problem = integer(1)(value, joints)
    return problem or (
        "" if value <= most else f"there is no joint {_quoted(value)}; the arm has at most {most}"
    )


def joint_key(value: Any, joints: int | None) -> str:
    """Check that a JSON key is the number of a joint (from 1); return the problem as text, "" if it is valid."""
    if not re.fullmatch(r"[1-9]\d{0,2}", value):
        return f"must be the number of a joint, not {_quoted(value)}"
    return joint_number(int(value), joints)


def one_of(*options: str) -> Check:
    """Return a check that accepts only these texts."""
    wrong = f"is not one of {', '.join(options)}"
    return lambda value, _: "" if value in options else f"{_quoted(value)} {wrong}"


def nullable(other: Check) -> Check:
    """Return a check that accepts null and what `other` accepts."""
    return lambda value, joints: "" if value is None else other(value, joints)


def list_of(item: Check) -> Check:
    """Return a check that accepts a list of items that pass `item`."""

    def check(value: Any, joints: int | None) -> str:
        problems = (f"item {k}: {p}" for k, v in enumerate(value, 1) if (p := item(v, joints)))
        return next(problems, "")

    return both(a_list, check)


def per_joint(item: Check) -> Check:
    """Return a check that accepts a list with one item for each joint, each of which passes `item`."""

    def check(value: Any, joints: int | None) -> str:
        if joints is not None and len(value) != joints:
            return f"has {len(value)} items instead of {joints}, one for each joint"
        return "" if 1 <= len(value) <= MOST_JOINTS_RECORDED else f"has {len(value)} items"

    return both(list_of(item), check)


def endpoint(value: Any, joints: int | None) -> str:
    """Check an endpoint: position (3 items) or position and rotation vector (6); return the problem or ""."""
    problem = list_of(AN_ANGLE)(value, joints)
    return problem or ("" if len(value) in (3, 6) else f"has {len(value)} items instead of 3 or 6")


def mapping_of(key: Check, item: Check) -> Check:
    """Return a check that accepts an object whose keys pass `key` and whose values pass `item`."""

    def check(value: Any, joints: int | None) -> str:
        problems = ((k, p) for k, v in value.items() if (p := key(k, joints) or item(v, joints)))
        return next((f"{_quoted(k)}: {p}" for k, p in problems), "")

    return both(an_object, check)


def object_with(checks: Mapping[str, Check]) -> Check:
    """Return a check that accepts an object whose values at these keys pass; other keys are ignored."""

    def check(value: Any, joints: int | None) -> str:
        key, problem = _first_problem(checks, value, joints)
        return f"{key}: {problem}" if problem else ""

    return both(an_object, check)


def _quoted(value: Any) -> str:
    match value:
        case None:
            return "null"
        case bool():
            return "true" if value else "false"
        case int() if abs(value) > MOST_WHOLE:
            return f"a number of {len(str(abs(value)))} digits"
        case int() | float():
            return f"{value}"
        case str():
            return ascii(value[:40])
        case list():
            return "a list"
        case _:
            return "an object"


# -- the events ----------------------------------------------------------------------------------

AN_ANGLE = number(-MAX_ANGLE_RAD, MAX_ANGLE_RAD)
ANGLES = per_joint(AN_ANGLE)
DEVIATIONS = per_joint(number(0.0, MAX_ANGLE_RAD))
COUNT = integer(1)
JOINTS = list_of(joint_number)
A_DURATION = number(0.0)

SETTINGS = object_with(
    {
        "poses?": nullable(COUNT),
        "plan?": nullable(one_of("explore", "planned")),
        "estimator?": nullable(one_of("implicit", "paper")),
        "unsensed_joints?": nullable(JOINTS),
        "length_tolerance_m?": nullable(number(0.0, 10.0)),
        "upload?": nullable(boolean),
        "interface?": nullable(text),
        "channel?": nullable(text),
        "bitrate?": nullable(COUNT),
        "profile?": nullable(text),
        "scenario?": nullable(one_of(*SCENARIOS)),
        "seed?": nullable(integer(0)),
        "tracker?": nullable(text),
        "operator?": nullable(text),
        "placements?": nullable(COUNT),
        "verifies?": text,
        "drop_unidentifiable?": nullable(boolean),
    }
)
NODE = object_with({"node": integer(0, 127), "serial_number": integer(0), "device_name?": text})
RECEIPT = object_with({"slot": text, "length": integer(0), "sha256": text})
WEAK = object_with({"name": text, "sigma": nullable(number(0.0)), "requested": number(0.0)})
MEASURED_POSE: Mapping[str, Check] = {
    "number": COUNT,
    "mean_rad": ANGLES,
    "sd_rad": DEVIATIONS,
    "samples": COUNT,
    "placement?": COUNT,
    "endpoint?": endpoint,
}

PER_JOINT = ("start_rad", "mean_rad", "sd_rad", "modes", "at_rad", "q_rad")

EVENTS: Mapping[str, Mapping[str, Check]] = {
    "opened": {"sources": mapping_of(text, text), "settings": SETTINGS},
    "resumed": {"settings": SETTINGS},
    "imported": {"file": text, "serial_number": text},
    "connected": {
        "serial_number": text,
        "model?": text,
        "nodes?": list_of(NODE),
        "configured?": list_of(text),
    },
    "reset": {"joints?": JOINTS, "code?": integer(0)},
    "sensor_fault": {"joint": joint_number, "text": text},
    "late": {"times": COUNT, "last_s": A_DURATION, "longest_s": A_DURATION},
    "return_holds": {"of?": integer(0)},
    "standing": {"told?": text, "probability?": nullable(number(0.0, 1.0)), "refused?": boolean},
    "control": {"start_rad": ANGLES, "home_rad?": ANGLES},
    "modes": {"modes": per_joint(one_of("position", "free"))},
    "remounting": {"placement": integer(2)},
    "remounted": {"placement": integer(2)},
    "went_home": {"joints": JOINTS, "q_rad": ANGLES, "stopped?": text},
    "waypoint_skipped": {"waypoint": integer(0), "reason?": text},
    "pose": {
        **MEASURED_POSE,
        "waypoint": integer(-1),
        "note?": text,
        "planned?": boolean,
        "first_sync?": integer(0),
        "taken_utc?": text,
    },
    "reading": {**MEASURED_POSE, "kind": text, "of?": integer(0)},
    "pose_undone": {"number": COUNT},
    "pose_restored": {"number": COUNT},
    "pose_excluded": {"number": COUNT, "text": text},
    "pose_included": {"number": COUNT},
    "pose_noted": {"number": COUNT, "text": text},
    "drives_chosen": {"drives": JOINTS, "sets": list_of(JOINTS)},
    "campaign": {
        "poses": integer(0),
        "requested": mapping_of(text, number(0.0)),
        "unsensed_joints": JOINTS,
        "samples": COUNT,
        "seed": integer(0),
        "candidates": COUNT,
        "drive_sets": list_of(JOINTS),
        "start_rad": ANGLES,
        "at_rad": ANGLES,
        "captured": list_of(COUNT),
    },
    "campaign_move": {
        "targets_rad": mapping_of(joint_key, AN_ANGLE),
        "q_rad": ANGLES,
        "stopped?": text,
    },
    "campaign_drives": {"drives": JOINTS, "q_rad": ANGLES},
    "campaign_ended": {"complete": boolean, "text": text, "weak": list_of(WEAK)},
    "solved": {
        "estimator?": one_of("implicit", "paper"),
        "unsensed_joints?": JOINTS,
        "length_tolerance_m?": nullable(number(0.0, 10.0)),
        "poses?": list_of(COUNT),
        "rereads?": integer(0),
        "parameters?": mapping_of(text, number()),
        "scaled_condition_number?": number(),
        "accepted": boolean,
        "record?": an_object,  # its contents are checked where they are read
        "made_with?": mapping_of(text, text),
    },
    "checked": {"record": an_object},
    "verified": {"poses?": COUNT, "position_m?": number(0.0), "holds?": boolean, "why?": text},
    "exported": {
        "file": text,
        "uploaded": nullable(RECEIPT),
        "sha256?": text,
        "forced?": text,
        "unknown?": text,
    },
    "return_missed": {"of?": integer(0), "reason?": text},
    "repaired": {"lost": list_of(integer(1)), "original?": text},
    "closed": {"reason?": text},
}
"""Check of each key that the program reads, by event. Keys with "?" are optional. Other keys are ignored."""
