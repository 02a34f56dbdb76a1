"""Computes the session state from journal events alone, one event after the other."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import reduce
from typing import Any

from hardware.arm import HostLatency, JointMode
from operator_app.errors import JournalDamagedError
from operator_app.session.store.events import event_problem, joint_count_in
from operator_app.session.store.journal_format import JournalContents, JournalEvent
from operator_app.session.store.state import (
    UNSOLVED,
    CampaignLog,
    CapturedPose,
    CheckReading,
    SessionState,
)
from operator_app.units import MOST_WHOLE
from solver.arrays import frozen


def order_of(opened: Mapping[str, Any]) -> int:
    """Return a session's order number (see `SessionState`) from the data of its `opened` event; 0 if it has none."""
    order = opened.get("order")
    return order if type(order) is int and 0 < order < MOST_WHOLE else 0


FIELDS_SET: Mapping[str, Callable[[Mapping[str, Any]], dict[str, Any]]] = {
    "imported": lambda data: {"imported": data["file"], "serial_number": data["serial_number"]},
    "modes": lambda data: {"modes": tuple(map(JointMode, data["modes"]))},
    "drives_chosen": lambda data: {
        "drives": tuple(data["drives"]),
        "drive_sets": tuple(map(tuple, data["sets"])),
    },
    "campaign": lambda data: {"campaign": CampaignLog(begun=dict(data))},
    "checked": lambda data: {"checks": data["record"]},
    "exported": lambda data: {"exported": dict(data)},
    "return_missed": lambda data: {"missed_repeat": data.get("reason", "")},
    "return_holds": lambda _: {"sensor_jump": "", "resumed": False},
}
"""Functions from an event's data to the fields that it sets, for events whose effect does not depend on the state."""


def apply(state: SessionState, event: JournalEvent) -> SessionState:
    """Return the state after one event; unknown events (from a newer version) change nothing."""
    name, data, utc = event.name, event.data, event.utc
    if name in FIELDS_SET:
        return replace(state, **FIELDS_SET[name](data))
    match name:
        case "opened":
            return replace(
                state,
                opened_utc=utc,
                order=order_of(data),
                sources=dict(data["sources"]),
                settings=dict(data["settings"]),
            )
        case "resumed":
            settings = {**state.settings, **data["settings"]}
            return replace(_with_skipped_open(state), resumed=True, settings=settings)
        case "connected":
            serials = {n["node"]: n["serial_number"] for n in data.get("nodes", ())}
            return replace(
                _with_skipped_open(state),
                serial_number=data["serial_number"],
                # The nodes that captured the poses remain the reference.
                node_serials=state.node_serials if state.poses else serials,
                resumed=state.resumed or bool(state.poses),
            )
        case "control":
            if state.start_rad is not None:
                return state
            start = frozen(data["start_rad"])
            home = frozen(data.get("home_rad", data["start_rad"]))
            return replace(state, start_rad=start, home_rad=home)
        case "waypoint_skipped":
            waypoint = data["waypoint"]
            return replace(
                state,
                visited=state.visited | {waypoint},
                skipped_waypoints={**state.skipped_waypoints, waypoint: data.get("reason", "")},
            )
        case "pose":
            pose = CapturedPose(
                # For poses from a file, the time of the event is that of the import.
                **_measured(data, data.get("taken_utc", utc)),
                waypoint=data["waypoint"],
                note=data.get("note", ""),
                planned=bool(data.get("planned")),
            )
            log = state.campaign
            return replace(
                state,
                poses=(*state.poses, pose),
                captured=pose.number,
                visited=state.visited | {pose.waypoint},
                campaign=log.step(name, data) if "planned" in data else log,
                **UNSOLVED,
            )
        case "pose_undone" | "pose_restored":
            return _undone(state, data["number"], back=name == "pose_restored")
        case "pose_excluded":
            return _with_other_poses(state, _edit(state, data["number"], excluded=data["text"]))
        case "pose_included":
            return _with_other_poses(state, _edit(state, data["number"], excluded=""))
        case "pose_noted":
            return replace(state, poses=_edit(state, data["number"], note=data["text"]))
        case "remounting" | "remounted":
            return _in_new_placement(state, data["placement"], mounted=name == "remounted")
        case _:
            return _apply_results(state, event)


def _measured(data: Mapping[str, Any], utc: str) -> dict[str, Any]:
    return {
        "number": data["number"],
        "mean_rad": frozen(data["mean_rad"]),
        "sd_rad": frozen(data["sd_rad"]),
        "samples": data["samples"],
        "utc": utc,
        "placement": data.get("placement", 1),
        "endpoint": tuple(data.get("endpoint", ())),
    }


def _undone(state: SessionState, number: int, *, back: bool) -> SessionState:
    numbers = {p.number for p in state.undone} - {number} | (set() if back else {number})
    every = sorted((*state.poses, *state.undone), key=lambda p: p.number)
    undone = tuple(p for p in every if p.number in numbers)
    poses = tuple(p for p in every if p.number not in numbers)
    return _with_other_poses(replace(state, undone=undone), poses)


def _apply_results(state: SessionState, event: JournalEvent) -> SessionState:
    name, data, utc = event.name, event.data, event.utc
    match name:
        case "campaign_move" | "campaign_drives":
            return replace(state, campaign=state.campaign.step(name, data))
        case "campaign_ended":
            return replace(state, campaign=replace(state.campaign, ended=dict(data)))
        case "solved":
            summary = {k: v for k, v in data.items() if k != "record"}
            new = {"solved": summary, "solution": data.get("record", {}), "solved_utc": utc}
            return replace(state, **{**UNSOLVED, **new})
        case "late":
            late = HostLatency(
                times=state.late.times + data["times"],
                last_s=data["last_s"],
                longest_s=max(state.late.longest_s, data["longest_s"]),
            )
            return replace(state, late=late)
        case "reading":
            reading = CheckReading(
                **_measured(data, utc),
                kind=data["kind"],
                of=data.get("of", 0),
                after=state.captured,
            )
            back = reading.kind == "return"
            return replace(
                state,
                readings=(*state.readings, reading),
                # After a sensor fault, only the event return_holds shows that the poses are still valid.
                resumed=bool(state.sensor_jump),
                missed_repeat="" if back else state.missed_repeat,
            )
        case "repaired" if data["lost"]:
            # The lost lines may contain poses or exclusions: results are no longer valid.
            return replace(_with_other_poses(state, state.poses), resumed=True)
        case "sensor_fault" if state.poses:
            return replace(state, sensor_jump=data["text"], resumed=True)
        case "verified":
            return replace(state, verifications=state.verifications + 1)
        case _:
            return state


def _with_skipped_open(state: SessionState) -> SessionState:
    """Return the state with skipped waypoints marked as not visited, so that they are tried again."""
    visited = state.visited.difference(state.skipped_waypoints)
    return replace(state, visited=visited, skipped_waypoints={})


def _in_new_placement(state: SessionState, placement: int, *, mounted: bool) -> SessionState:
    return replace(
        state,
        placement=placement,
        mounted=mounted,
        start_rad=None,
        home_rad=None,
        modes=(),
        visited=frozenset(),
        skipped_waypoints={},
        resumed=False,
        sensor_jump="",
    )


def _with_other_poses(state: SessionState, poses: tuple[CapturedPose, ...]) -> SessionState:
    campaign = replace(state.campaign, ended={})
    return replace(state, poses=poses, campaign=campaign, **UNSOLVED)


def _edit(state: SessionState, number: int, **changed: Any) -> tuple[CapturedPose, ...]:
    return tuple(replace(p, **changed) if p.number == number else p for p in state.poses)


def session_state(contents: JournalContents, *, joint_count: int | None = None) -> SessionState:
    """Return the state after all events of a journal; checks each event first.

    `joint_count`: number of the arm's joints; None: taken from the first event that has a value for each joint. Raises
    JournalDamagedError if the data of a line are invalid.
    """
    state, joints = SessionState(), joint_count
    for event in contents.events:
        key, problem = event_problem(event, joints, state.captured)
        if problem:
            where = f"{event.name}.{key}" if key != "utc" else key
            raise JournalDamagedError(
                path=contents.file, line=event.seq, problem=f"{where}: {problem}"
            )
        joints = joints or joint_count_in(event)
        state = apply(state, event)
    return state


def replay(events: Iterable[JournalEvent]) -> SessionState:
    """Return the state after these events, without checking them."""
    return reduce(apply, events, SessionState())
