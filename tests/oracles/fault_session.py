"""One session on the virtual arm in which one thing goes wrong, and what came of it.

The arm is the paper's without any error of its own (scenario ``exact``), so that whether an accepted pose is
right can be told from the pose alone: the loop of the paper's tables closes at it, or it does not.
"""

import itertools
import os
import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np

from hardware.arm import DriveState, JointMode
from hardware.buses.python_can import BusSettings
from hardware.virtual.controller import VirtualController
from hardware.virtual.embedded_bus import attended_openers
from hardware.virtual.faults import ScriptedFault, inject, scripted
from hardware.virtual.plant import Plant
from operator_app.messages.errors import EXPECTED
from operator_app.session.store.journal import Clock, utc_now
from operator_app.session.store.state import CapturedPose
from operator_app.session.workflow.capture import connect, take_poses
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.opening import Choices
from operator_app.virtual_arms import run_controller
from tests.oracles.fast_arm import fast_arm
from tests.oracles.hearing import Hearing
from tests.oracles.loop_oracle import paper_truth, product
from tests.oracles.opened import opened
from tests.oracles.short_procedure import short_procedure

CLOSES = 3e-4
"""Largest element of the loop's error, rad and m: 400,000-count encoders round to 8e-6 rad each."""

PATIENCE_S = 1.5
LIVES_ON_SYNCS = 150
"""How long the arm is looked at after the words: 1.5 s of its time."""
T = TypeVar("T")
_channels = itertools.count()


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What the operator was told ("" if nothing), and what the journal accepted.

    `reaction_s` is the CPU time of this process, virtual arm and all, from the fault to the words; 0 without.
    `moved_deg` is how far any true angle went in the 1.5 s after the words, nobody commanding, and `then` what
    each drive was at when they were said; `ended` what it does once the session is closed. `told` are sentences
    that ended nothing.
    """

    kind: str
    said: str
    error: str
    poses: tuple[CapturedPose, ...]
    wrong: tuple[int, ...]
    reaction_s: float
    moved_deg: float
    then: tuple[tuple[DriveState, JointMode | None], ...]
    ended: tuple[JointMode | None, ...]
    told: tuple[str, ...]


def loop_error(q_rad: np.ndarray) -> float:
    """By how much the paper's loop fails to close at these readings, the hinge where it fits best."""
    truth = paper_truth()
    theta = np.concatenate([[0.0], q_rad]) + truth.theta_off
    arm = product(theta[1:], truth.s[1:], truth.a[1:], truth.alpha[1:])
    wanted = np.linalg.inv(arm)  # what A_0 has to be
    theta_0 = np.arctan2(wanted[1, 0], wanted[0, 0])
    hinge = product(np.array([theta_0]), truth.s[:1], truth.a[:1], truth.alpha[:1])
    return float(np.abs(hinge @ arm - np.eye(4)).max())


def in_the_loop(controller: VirtualController, reader: Callable[[], T]) -> T:
    """Run something where the drives live, and return what it says."""
    found: queue.SimpleQueue[T] = queue.SimpleQueue()
    controller.resume_loop()
    controller.post(lambda: found.put(reader()))
    return found.get(timeout=10.0)


def drives_of(controller: VirtualController) -> tuple[tuple[DriveState, JointMode | None], ...]:
    """What each drive is at, and what it does about it: None blocks its valve."""
    return tuple((node.drive.state, node.drive.command().mode) for node in controller.drives)


def lives_on(
    controller: VirtualController,
) -> tuple[tuple[tuple[DriveState, JointMode | None], ...], float]:
    """What the drives are at, and how far any true angle (deg) goes while nobody tells them anything."""

    def live() -> tuple[tuple[tuple[DriveState, JointMode | None], ...], float]:
        plant = controller.plant
        assert isinstance(plant, Plant)
        then, begun, farthest = drives_of(controller), plant.true_angles_rad, 0.0
        for _ in range(LIVES_ON_SYNCS):
            controller.group.step()
            farthest = max(farthest, float(np.abs(plant.true_angles_rad - begun).max()))
        return then, float(np.rad2deg(farthest))

    return in_the_loop(controller, live)


def heed_stop(controller: VirtualController) -> None:
    """Let the stop that was sent reach the drives: the words may be there before its frames are read."""
    until_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < until_s:
        states = in_the_loop(controller, lambda: {state for state, _ in drives_of(controller)})
        if DriveState.OPERATION_ENABLED not in states:
            return
        threading.Event().wait(0.01)


def come_to_hold(controller: VirtualController) -> tuple[JointMode | None, ...]:
    """What the drives do once the operator is gone, at the latest when its heartbeat is missed."""
    until_s = time.monotonic() + 3 * PATIENCE_S
    while True:
        modes = in_the_loop(controller, lambda: tuple(mode for _, mode in drives_of(controller)))
        if JointMode.FREE not in modes or time.monotonic() > until_s:
            return modes
        threading.Event().wait(0.05)


def session_with(
    kind: str, folder: Path, *, joint: int, at_sync: int, poses: int = 6, clock: Clock = utc_now
) -> Outcome:
    """Take poses while `kind` happens to `joint` at a SYNC (0: before anybody connects).

    An empty kind is nothing; `clock` is the operator's wall clock.
    """
    script: Sequence[ScriptedFault] = ()
    begun_s: list[float] = []

    def begin() -> None:
        begun_s.append(time.process_time())

    reaction_s = moved_deg = 0.0
    then: tuple[tuple[DriveState, JointMode | None], ...] = ()
    if kind and at_sync:
        fault = scripted(kind, joint=joint, at_sync=at_sync)
        script = [replace(fault, happen=lambda arm: (begin(), fault.happen(arm))[-1])]
    chosen = Choices(scenario="exact", seed=0)
    procedure = short_procedure(poses)
    settings = BusSettings(channel=f"campaign-{os.getpid()}-{next(_channels)}")
    said, error, hearing = "", "", Hearing()
    with run_controller(
        procedure.arm,
        chosen,
        settings,
        heartbeat_timeout_s=PATIENCE_S,
        script=script,
        attended=True,
    ) as controller:
        openers = attended_openers(controller)
        arm = fast_arm(
            procedure.arm,
            settings,
            patience_s=PATIENCE_S,
            answers_s=0.05,
            sdo_timeout_s=PATIENCE_S,
            openers=openers,
        )
        if kind and not at_sync:
            begin()
            inject(controller, kind, joint)
        session = opened(folder, arm, procedure, clock=clock)
        try:
            connect(session, Listener())
            session.require_fixture()
            take_poses(session, hearing, (1, 5))
        except EXPECTED as found:
            said, error = str(found), type(found).__name__
            reaction_s = time.process_time() - begun_s[0] if begun_s else 0.0
            if session.identity is not None and arm.snapshot().stopped:
                heed_stop(controller)
            then, moved_deg = lives_on(controller)
        finally:
            controller.resume_loop()
            session.close("done")
        ended = come_to_hold(controller)
    used = session.state.used_poses
    return Outcome(
        kind=kind,
        said=said,
        error=error,
        poses=used,
        wrong=tuple(p.number for p in used if loop_error(p.mean_rad) > CLOSES),
        reaction_s=reaction_s,
        moved_deg=moved_deg,
        then=then,
        ended=ended,
        told=tuple(hearing.said),
    )
