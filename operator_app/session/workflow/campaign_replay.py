"""Rebuilds a planning campaign from the journal, which is possible because the policy is deterministic."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from fixtures.base import EndpointConstraint
from operator_app.planning.task import planning_task
from operator_app.session.store.state import SessionState
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.design.actions import Action, Capture, ChangeDrives, Finished, GoTo
from solver.design.campaign import Campaign

SAME_POSITION_RAD = float(np.deg2rad(1.5))
"""An arm within this distance of its last position in the journal is regarded as unmoved."""
SAME_TARGET_RAD = 1e-6
"""Largest difference between the recorded and the replayed target of a move."""


class ReplayDivergedError(Exception):
    """The policy proposes an action that differs from the one recorded in the journal."""


def campaign_from_log(arm: ArmModel, fixture: EndpointConstraint, state: SessionState) -> Campaign:
    """Return the recorded campaign in the state in which it started, before its recorded steps."""
    begun = state.campaign.begun
    known = {p.number: p for p in state.used_poses}
    captured = [known[number] for number in begun["captured"]]
    return Campaign(
        task=planning_task(
            arm,
            fixture,
            drive_sets=tuple(tuple(drives) for drives in begun["drive_sets"]),
            unsensed_joints=tuple(begun["unsensed_joints"]),
            samples=begun["samples"],
            seed=begun["seed"],
            candidates=begun["candidates"],
        ),
        start_rad=np.array(begun["start_rad"]),
        poses=begun["poses"],
        requested=begun["requested"],
        captured=np.array([p.mean_rad for p in captured]) if captured else None,
        taken=sum(p.planned for p in captured),
        at_rad=np.array(begun["at_rad"]),
    )


def log_is_current(state: SessionState, settings: Mapping[str, Any]) -> bool:
    """Whether the recorded campaign contains exactly the used poses and was begun with the same `settings`."""
    log = state.campaign
    started = set(log.begun["captured"]) | {
        data["number"] for name, data in log.steps if name == "pose"
    }
    counting = {p.number for p in state.used_poses}
    return started == counting and all(
        log.begun.get(key) == value for key, value in settings.items()
    )


def replay_campaign(arm: ArmModel, fixture: EndpointConstraint, state: SessionState) -> Campaign:
    """Return the recorded campaign in its state after all recorded steps.

    Raises ReplayDivergedError if the policy proposes an action that differs from the one recorded in the journal.
    """
    campaign = campaign_from_log(arm, fixture, state)
    readings = {p.number: p.mean_rad for p in state.used_poses}
    for name, data in state.campaign.steps:
        if not is_same_action(campaign.propose(), name, data):
            raise ReplayDivergedError
        if name == "pose":
            campaign.captured(readings[data["number"]])
        else:
            campaign.observe(np.array(data["q_rad"]), data.get("stopped", ""))
    return campaign


def is_same_action(action: Action, name: str, data: Mapping[str, Any]) -> bool:
    """Whether `action` equals the action recorded in the journal as event `name` with `data`."""
    match action, name:
        case GoTo(), "campaign_move":
            then = {int(j): v for j, v in data["targets_rad"].items()}
            return then.keys() == action.targets_rad.keys() and all(
                abs(then[j] - v) <= SAME_TARGET_RAD for j, v in action.targets_rad.items()
            )
        case ChangeDrives(), "campaign_drives":
            return action.drives == tuple(data["drives"])
        case Capture(), "pose":
            return action.planned is bool(data["planned"])
    return False


def can_continue_from(action: Action, last_rad: FloatArray, q_rad: FloatArray) -> bool:
    """Whether an arm at `q_rad` can do `action`: always if Finished, else at the recorded `last_rad` or on the path."""
    if float(np.abs(q_rad - last_rad).max()) <= SAME_POSITION_RAD or isinstance(action, Finished):
        return True
    if not isinstance(action, GoTo):
        return False
    if action.trace_rad is not None:
        return float(np.abs(action.trace_rad - q_rad).max(axis=-1).min()) <= SAME_POSITION_RAD
    columns = [j - 1 for j in action.targets_rad]
    goal = np.array(list(action.targets_rad.values()))
    step = goal - last_rad[columns]
    length = max(float(step @ step), 1e-12)
    along = float(np.clip((q_rad[columns] - last_rad[columns]) @ step / length, 0.0, 1.0))
    distance = np.abs(q_rad[columns] - last_rad[columns] - along * step)
    return float(distance.max()) <= SAME_POSITION_RAD
