"""One session on the virtual arm with one injected fault, and its outcome.

The arm has no errors (scenario ``exact``), so that an accepted pose is right if the loop of the paper's tables closes.
"""

import itertools
import os
import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from hardware.arm import DriveState, JointMode
from hardware.buses.python_can import BusSettings
from hardware.virtual.controller import VirtualController
from hardware.virtual.embedded_bus import attended_opener
from hardware.virtual.fault_messages import FAULTS, ArmReaction
from hardware.virtual.faults import ScriptedFault, inject
from hardware.virtual.plant import Plant
from operator_app.messages.errors import EXPECTED
from operator_app.session.store.journal import Clock, utc_now
from operator_app.session.store.state import CapturedPose
from operator_app.session.workflow.capture import connect, take_poses
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.opening import Choices
from operator_app.virtual_arms import run_controller
from tests.oracles.fast_arm import fast_arm
from tests.oracles.loop_oracle import paper_truth, product
from tests.oracles.plant_sessions import RecordingListener, opened, short_procedure

MAX_CLOSURE_ERROR = 3e-4
"""Largest closure error of a right pose, rad and m: encoders of 400,000 counts round to 8e-6 rad each."""

PATIENCE_S = 1.5
OBSERVED_SYNCS = 150
"""Duration of the observation after the error message: 1.5 s of the arm's time."""
T = TypeVar("T")
DriveStates = tuple[tuple[DriveState, JointMode | None], ...]
"""State of each drive, and its active mode; without a mode it blocks its valve."""
_channels = itertools.count()


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Outcome of a session.

    `message`: of the error that ended it, or "". `poses`, `wrong`: accepted poses, and the numbers of wrong ones.
    `moved_deg`, `states`, `states_later`: largest motion of a true angle in the 1.5 s after the message, without
    commands; the drives at the message, and after these 1.5 s. `final_modes`: of the drives after the session was
    closed. `reports`: those that did not end it.
    """

    message: str
    poses: tuple[CapturedPose, ...]
    wrong: tuple[int, ...]
    moved_deg: float
    states: DriveStates
    states_later: DriveStates
    final_modes: tuple[JointMode | None, ...]
    reports: tuple[str, ...]


def loop_error(q_rad: np.ndarray) -> float:
    """Closure error of the paper's loop at these readings, at the best hinge angle."""
    truth = paper_truth()
    theta = np.concatenate([[0.0], q_rad]) + truth.theta_off
    arm = product(theta[1:], truth.s[1:], truth.a[1:], truth.alpha[1:])
    link_0 = np.linalg.inv(arm)
    theta_0 = np.arctan2(link_0[1, 0], link_0[0, 0])
    hinge = product(np.array([theta_0]), truth.s[:1], truth.a[:1], truth.alpha[:1])
    return float(np.abs(hinge @ arm - np.eye(4)).max())


def call_in_loop(controller: VirtualController, reader: Callable[[], T]) -> T:
    """Return the result of a function that runs in the controller's thread."""
    results: queue.SimpleQueue[T] = queue.SimpleQueue()
    controller.running.set()
    controller.post(lambda: results.put(reader()))
    return results.get(timeout=60.0)


def drives_of(controller: VirtualController) -> DriveStates:
    return tuple((node.drive.state, node.drive.command()[0]) for node in controller.drives)


def observe_drives(controller: VirtualController) -> tuple[DriveStates, DriveStates, float]:
    """The drives' states now and later, and the largest motion (deg) of a true angle without further commands."""

    def observe() -> tuple[DriveStates, DriveStates, float]:
        plant = controller.plant
        assert isinstance(plant, Plant)
        states, start, largest = drives_of(controller), plant.true_angles_rad, 0.0
        for _ in range(OBSERVED_SYNCS):
            controller.group.step()
            largest = max(largest, float(np.abs(plant.true_angles_rad - start).max()))
        return states, drives_of(controller), float(np.rad2deg(largest))

    return call_in_loop(controller, observe)


def wait_for_drives(
    controller: VirtualController, condition: Callable[[DriveStates], bool], *, patience_s: float
) -> DriveStates:
    """Wait until the drives' states meet a condition, or until a timeout, and return them."""
    until_s = time.monotonic() + patience_s
    while True:
        states = call_in_loop(controller, lambda: drives_of(controller))
        if condition(states) or time.monotonic() > until_s:
            return states
        threading.Event().wait(0.01)


def stopped(states: DriveStates) -> bool:
    return DriveState.OPERATION_ENABLED not in {state for state, _ in states}


def reacted(states: DriveStates) -> bool:
    """Whether the drives have stopped, or one has tripped, which stops the others in the next control period."""
    tripped = {DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE}
    return stopped(states) or bool(tripped & {state for state, _ in states})


def holding(states: DriveStates) -> bool:
    return JointMode.FREE not in {mode for _, mode in states}


def run_session_with_fault(
    kind: str, folder: Path, *, joint: int, at_sync: int, poses: int = 6, clock: Clock = utc_now
) -> Outcome:
    """Take poses with a fault of `joint` at a SYNC (0: before the connection).

    An empty kind is no fault; `clock` is the operator's wall clock.
    """
    script: Sequence[ScriptedFault] = ()
    moved_deg = 0.0
    states: DriveStates = ()
    later: DriveStates = ()
    if kind and at_sync:
        script = [ScriptedFault(kind=kind, joint=joint, at_sync=at_sync)]
    chosen = Choices(scenario="exact", seed=0)
    procedure = short_procedure(poses)
    settings = BusSettings(channel=f"campaign-{os.getpid()}-{next(_channels)}")
    message, listener = "", RecordingListener()
    with run_controller(
        procedure.arm,
        chosen,
        settings,
        fixture=procedure.fixture,
        heartbeat_timeout_s=PATIENCE_S,
        script=script,
        attended=True,
    ) as controller:
        arm = fast_arm(
            procedure.arm,
            settings,
            patience_s=PATIENCE_S,
            answers_s=0.05,
            sdo_timeout_s=PATIENCE_S,
            open_main=attended_opener(controller),
        )
        if kind and not at_sync:
            inject(controller, kind, joint)
        session = opened(folder, arm, procedure, clock=clock)
        try:
            connect(session, Listener())
            session.require_fixture()
            take_poses(session, listener, (1, 5))
        except EXPECTED as exception:
            message = str(exception)
            holds = kind in FAULTS and FAULTS[kind].arm is ArmReaction.HOLDS
            if session.identity is not None and (holds or arm.snapshot().stopped):
                # The message may precede the frames of the stop, or the time-out of the drive that causes it.
                condition = reacted if holds else stopped
                wait_for_drives(controller, condition, patience_s=PATIENCE_S)
            states, later, moved_deg = observe_drives(controller)
        finally:
            controller.running.set()
            session.close("done")
        # At the latest after the timeout of the operator's heartbeat.
        ended = wait_for_drives(controller, holding, patience_s=3 * PATIENCE_S)
    used = session.state.used_poses
    return Outcome(
        message=message,
        poses=used,
        wrong=tuple(p.number for p in used if loop_error(p.mean_rad) > MAX_CLOSURE_ERROR),
        moved_deg=moved_deg,
        states=states,
        states_later=later,
        final_modes=tuple(mode for _, mode in ended),
        reports=tuple(listener.reports),
    )
