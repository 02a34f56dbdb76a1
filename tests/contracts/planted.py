"""Loops with a planted truth: every fixture on two arms, with poses that close there exactly. No test in it."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from fixtures.ball import Ball
from fixtures.base import EndpointConstraint
from fixtures.hinge import Hinge
from fixtures.measured import Measured
from fixtures.rigid import Rigid
from solver.chain.arm_model import ArmModel, Joint
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhEntry, DhKind, nominal_vector
from solver.chain.sensors import Encoder
from solver.closing import close_loops
from solver.diagnostics.model_selection import drop_unidentifiable
from solver.loops.closure import ClosureModel
from solver.loops.open_arm import MeasuredClosure

FIXTURES: dict[str, type[EndpointConstraint]] = {
    "ball": Ball,
    "hinge": Hinge,
    "measured": Measured,
    "rigid": Rigid,
}
"""One line a fixture: the contract tests run on each."""


def arm(name: str, table: DhTable, home_deg: list[float]) -> ArmModel:
    home = np.deg2rad(home_deg)
    joint = Joint(
        name="joint",
        lower_rad=-10.0,
        upper_rad=10.0,
        sensor=Encoder(counts_per_rev=400_000),
        max_speed_rad_per_s=1.0,
        max_torque_nm=10.0,
    )
    return ArmModel(
        name=name,
        table=table,
        joints=(joint,) * table.links,
        free=tuple(DhEntry(DhKind.THETA_OFF, j) for j in range(1, table.links + 1)),
        home_rad=home,
    )


def sarcos() -> ArmModel:
    """Spherical shoulder and wrist, as in the paper."""
    return arm(
        "sarcos",
        DhTable(
            theta_off_rad=np.deg2rad([10, -120, -20, -10, 30, 120, 90]),
            s_m=[0.27, 0.0, 0.355, 0.0, 0.320, 0.0, 0.04],
            a_m=[0.0] * 6 + [-0.1],
            alpha_rad=np.deg2rad([90, -90, 90, -90, 90, -90, 100]),
        ),
        [40.5311, 245.5792, 143.1309, -115.0631, -189.2465, -215.6707, 44.9482],
    )


def eight_joints() -> ArmModel:
    """No two neighbouring axes meet: nothing about seven joints or spherical wrists is built in."""
    return arm(
        "eight",
        DhTable(
            theta_off_rad=np.deg2rad([5, 10, -20, 30, -10, 0, 20, 10]),
            s_m=[0.3, 0.02, 0.25, -0.03, 0.2, 0.1, 0.02, 0.08],
            a_m=[0.03, 0.1, -0.05, 0.08, 0.04, 0.06, 0.05, 0.0],
            alpha_rad=np.deg2rad([-80, 85, 95, -70, 88, 60, -95, 0]),
        ),
        [10, -40, 20, -100, 30, 70, 40, -20],
    )


ARMS = {"sarcos": sarcos, "eight": eight_joints}


@dataclass(frozen=True)
class Case:
    """A fixture on an arm, with a planted truth and poses that close there exactly."""

    kind: str
    arm: ArmModel
    model: ClosureModel
    truth: np.ndarray
    q: np.ndarray


def observed(model: ClosureModel, x: np.ndarray, q: np.ndarray) -> ClosureModel:
    """Bind an open arm to what its instrument would see; a closed loop needs no instrument."""
    if isinstance(model, MeasuredClosure):
        position, rotation = model.predicted(x, q)
        return model.with_endpoints(position, rotation if model.full_pose else None)
    return model


def near_home(arm: ArmModel, rng: np.random.Generator, count: int) -> np.ndarray:
    """Inner joints up to 60 deg from home, first and last anywhere: their zeros are the fixture's."""
    q = arm.home_rad + rng.uniform(-1.0, 1.0, (count, arm.joint_count))
    q[:, [0, -1]] = rng.uniform(-np.pi, np.pi, (count, 2))
    return q


def closed_poses(
    model: ClosureModel,
    x: np.ndarray,
    arm: ArmModel,
    seed: int,
    *,
    count: int = 30,
    held: tuple[int, ...] = (),
) -> np.ndarray:
    rng = np.random.default_rng(seed)
    q = near_home(arm, rng, 12 * count)
    q[:, [j - 1 for j in held]] = arm.home_rad[[j - 1 for j in held]]
    sigma = np.ones(arm.joint_count)
    sigma[[j - 1 for j in held]] = 0.0
    if isinstance(model, MeasuredClosure):
        return q[:count]
    poses = close_loops(model, x, q, sigma_rad=sigma, max_iterations=60)
    # The shortest way to the manifold: what went far is another assembly of the arm.
    good = poses.closed & ~model.reduced(x, poses.q).flipped
    good &= np.abs(poses.q - q).max(-1) < 1.5
    found = poses.q[good][:count]
    assert len(found) == count, f"only {len(found)} of {count} poses close"
    return found


def perturbed(model: ClosureModel, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    size = np.where([p.is_angle for p in model.parameters], np.deg2rad(5.0), 0.02)
    return nominal_vector(model.parameters) + size * rng.uniform(-1.0, 1.0, len(size))


@cache
def case(kind: str, arm_name: str) -> Case:
    """What the poses cannot show is held first: a truth planted there would be nobody's to find."""
    arm = ARMS[arm_name]()
    model = FIXTURES[kind].example(arm).model(arm)
    x = nominal_vector(model.parameters)
    q = closed_poses(model, x, arm, seed=1)
    model, _ = drop_unidentifiable(observed(model, x, q), x, q)
    if isinstance(model, MeasuredClosure):
        model = replace(model, endpoint_m=None, endpoint_rotation=None)
    truth = perturbed(model, seed=2)
    q = closed_poses(model, truth, arm, seed=3)
    return Case(kind=kind, arm=arm, model=observed(model, truth, q), truth=truth, q=q)
