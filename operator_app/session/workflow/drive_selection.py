"""Selection of the drive joints: by prediction, or by trial motions of the arm; recorded with reasons."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from operator_app.planning.drives import (
    DriveChoice,
    DrivePrediction,
    choose_drives,
    predict_drives,
    sets_to_try,
)
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from solver.chain.parameters import nominal_vector
from solver.design.drive_joints import RankedDrives, TrialWiggles

WIGGLE_RAD = float(np.deg2rad(1.5))
KEPT = 6
"""Number of ranked sets recorded in the journal."""


def drives_of(session: Session, listener: Listener | None = None) -> tuple[int, ...]:
    """Return the drive joints: of the procedure, else those chosen before, else choose now."""
    named = session.procedure.position_joints
    if named is not None:
        return named
    if session.state.drives:
        return session.state.drives
    choice = choose(session)
    if listener is not None:
        listener.drives_chosen(choice)
    return choice.drives


def choose(session: Session) -> DriveChoice:
    """Rank the sets of drive joints at the present pose and record the best usable one.

    With `trial` in the procedure, the best ones are moved by 1.5 deg first, which enables the drives.
    """
    prediction = _predicted(session)
    trials: tuple[TrialWiggles, ...] = ()
    if session.procedure.trial:
        tried = sets_to_try(prediction, session.procedure.unsensed_joints)
        trials = tuple(wiggle(session, drives) for drives in tried)
    return _recorded(session, prediction, trials)


def choose_by_prediction(session: Session) -> DriveChoice:
    """Like `choose`, but always without a trial: nothing moves."""
    return _recorded(session, _predicted(session), ())


def _predicted(session: Session) -> DrivePrediction:
    arm, model = session.model, session.fixture.model(session.model)
    here = session.arm.snapshot().positions_rad
    return predict_drives(
        arm, model, nominal_vector(model.parameters), here, seed=session.procedure.capture.seed
    )


def _recorded(
    session: Session, prediction: DrivePrediction, trials: tuple[TrialWiggles, ...]
) -> DriveChoice:
    unsensed = session.procedure.unsensed_joints
    choice = choose_drives(prediction, unsensed_joints=unsensed, trials=trials)
    session.record(
        "drives_chosen",
        {
            "drives": list(choice.drives),
            "sets": [list(drives) for drives in choice.sets],
            "reasons": list(choice.reasons),
            "here": [_facts(r) for r in prediction.here[:KEPT]],
            "region": [_facts(r) for r in prediction.region[:KEPT]],
            "trial": [_facts(r) for r in choice.trial],
        },
    )
    return choice


def wiggle(session: Session, drives: tuple[int, ...]) -> TrialWiggles:
    """Move each drive joint by 1.5 deg to either side and back, and measure the motion of all joints."""
    session.set_modes(drives)
    start = session.read().mean_rad
    commanded, moved, stopped = [], [], ""
    for column, joint in enumerate(drives):
        for step in (WIGGLE_RAD, -WIGGLE_RAD):
            result = session.go_to({joint: float(start[joint - 1]) + step})
            stopped = stopped or ("" if result.reached else result.reason)
            if result.reached:
                asked = np.zeros(len(drives))
                asked[column] = step
                commanded.append(asked)
                moved.append(session.read().mean_rad - start)
            session.go_to({joint: float(start[joint - 1])})
    measured = np.linalg.matrix_rank(np.array(commanded)) if commanded else 0
    if measured < len(drives):
        # Too few moves were completed to measure anything.
        commanded, moved = (
            list(WIGGLE_RAD * np.eye(len(drives))),
            [np.zeros(len(start))] * len(drives),
        )
    return TrialWiggles(
        drives=drives,
        commanded_rad=np.array(commanded),
        moved_rad=np.array(moved),
        stopped=stopped,
    )


def _facts(ranked: RankedDrives) -> dict[str, Any]:
    return {key: value for key, value in asdict(ranked).items() if value is not None}
