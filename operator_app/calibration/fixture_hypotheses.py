"""Alternative fixtures: a hinge or ball located from the poses, and the command that writes its file."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fixtures.ball import Ball
from fixtures.base import Compliance, Fixture
from fixtures.hinge import Hinge
from fixtures.rigid import Rigid
from operator_app.messages.finding import Finding, FindingKind
from operator_app.units.figure import WHOLE_MM
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.kinematics import forward
from solver.chain.poses import PoseSet
from solver.loops.endpoint_geometry import Line

TURNS_RAD = 0.5e-3
"""How far an ordinary hinge turns under load where nobody states a hinge."""


class Other(NamedTuple):
    """A fixture that is there instead, and the finding."""

    finding: Finding
    fixture: Fixture


def instead(arm: ArmModel, fixture: Fixture, poses: PoseSet) -> Iterator[Other]:
    """Fixtures that hold less than `fixture`: loops that do not close in it may close in one of these."""
    if isinstance(fixture, Rigid):
        yield hinge_instead(arm, fixture, poses)
    if isinstance(fixture, Hinge | Rigid):
        yield _ball_instead(arm, fixture, poses)


def hinge_instead(arm: ArmModel, fixture: Fixture, poses: PoseSet) -> Other:
    """A hinge where the hand turns about one line of its own, which stays where it is in the base."""
    frames = _frames(arm, poses)
    m = len(poses)
    eye = np.broadcast_to(np.eye(3), (m, 3, 3))
    # R_k a = b: the two directions are what these rows see least.
    both = np.linalg.svd(np.concatenate((frames[0], -eye), axis=-1).reshape(-1, 6))[2][-1]
    along = [d / np.linalg.norm(d) for d in (both[:3], both[3:])]
    tip, ground = _where_it_meets(frames)
    hinge = Hinge.between(
        arm,
        Line(point_m=ground, direction=along[1]),
        Line(point_m=tip, direction=along[0]),
        compliance=Compliance(
            position_m=fixture.compliance.position_m,
            orientation_rad=fixture.compliance.orientation_rad or TURNS_RAD,
        ),
    )
    lines = f"{_points(tip, ground)} --hand-direction={_way(along[0])} --base-direction={_way(along[1])}"
    return Other(
        Finding(
            kind=FindingKind.WRONG_FIXTURE_HINGE,
            names=(fixture.kind, _new("hinge", arm, lines)),
        ),
        hinge,
    )


def _ball_instead(arm: ArmModel, fixture: Fixture, poses: PoseSet) -> Other:
    """A ball where the hinge is thought to be, or where the hand meets one point best."""
    R, p = frames = _frames(arm, poses)
    if isinstance(fixture, Hinge):
        tip = np.array([fixture.a_n_m, 0.0, fixture.s_n_m])
        ground = np.median(p + R @ tip, axis=0)
    else:
        tip, ground = _where_it_meets(frames)
    return Other(
        Finding(
            kind=FindingKind.WRONG_FIXTURE_BALL,
            names=(fixture.kind, _new("ball", arm, _points(tip, ground))),
        ),
        Ball(tip_m=_point(tip), ground_m=_point(ground), compliance=fixture.compliance),
    )


def _frames(arm: ArmModel, poses: PoseSet) -> tuple[FloatArray, FloatArray]:
    """Rotations (m, 3, 3) and origins (m, 3) of the hand in the base at nominal entries, m."""
    theta_off, *lengths_and_twists = arm.table.stacked()
    frames = forward(poses.q_rad + theta_off, *lengths_and_twists)
    return frames.R_end, frames.p_end


def _where_it_meets(frames: tuple[FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
    """A point of the hand (3,) and one of the base (3,), m, that meet best in all poses.

    Along a line about which the hand only turns, the point next to the origin.
    """
    R, p = frames
    eye = np.broadcast_to(np.eye(3), R.shape)
    rows = np.concatenate((R, -eye), axis=-1).reshape(-1, 6)
    found = np.linalg.lstsq(rows, -p.reshape(-1), rcond=0.02)[0]
    return np.asarray(found[:3]), np.asarray(found[3:])


def _new(kind: str, arm: ArmModel, where: str) -> str:
    return f"sarcal new fixture --kind {kind} --arm {arm.name} --name found {where}"


def _points(tip_m: FloatArray, ground_m: FloatArray) -> str:
    hand, base = (
        ",".join(WHOLE_MM(x).shown for x in (np.round(v, 3) + 0.0).tolist())
        for v in (tip_m, ground_m)
    )
    return f"--hand-point={hand} --base-point={base}"


def _way(direction: FloatArray) -> str:
    return ",".join(f"{x:.3f}" for x in np.round(direction, 3) + 0.0)


def _point(at: FloatArray) -> tuple[float, float, float]:
    return float(at[0]), float(at[1]), float(at[2])
