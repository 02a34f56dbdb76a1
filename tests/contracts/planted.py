"""Loops with planted parameters: every fixture on two arms, with poses that close exactly. No test in it."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from fixtures.ball import Ball
from fixtures.hinge import Hinge
from fixtures.measured import Measured
from fixtures.rigid import Rigid
from operator_app.config.arm_file import load_arm
from solver.chain.arm_model import ArmModel, Joint
from solver.chain.kinematics import DhTable, Frames, forward
from solver.chain.parameters import DhEntry, DhKind, nominal_vector
from solver.chain.rotations import rotation_about_z
from solver.chain.sensors import Encoder
from solver.closing import close_loops
from solver.diagnostics.model_selection import drop_unidentifiable
from solver.loops.closure import ClosureModel
from solver.loops.endpoint_geometry import Line
from solver.loops.endpoints import MeasuredClosure

EXAMPLE_TIP_M = (0.03, 0.02, 0.05)


def at_home(arm: ArmModel) -> Frames:
    """Frames 0 to n of the arm at home."""
    offsets, *lengths_and_twists = arm.table.stacked()
    return forward(arm.home_rad + offsets, *lengths_and_twists)


def ball(arm: ArmModel) -> Ball:
    """A ball beside the flange, with its socket at the home pose."""
    frames = at_home(arm)
    ground = frames.p_end + frames.R_end @ np.array(EXAMPLE_TIP_M)
    return Ball(tip_m=EXAMPLE_TIP_M, ground_m=tuple(ground.tolist()))


def hinge(arm: ArmModel) -> Hinge:
    """A hinge, at 100 deg to joint n, that closes at home except for rotations of joints 1 and n."""
    alpha_n = np.deg2rad(100.0)
    return hinge_at(arm, [-0.1, 0.0, 0.04], [0.0, -np.sin(alpha_n), np.cos(alpha_n)])


def rigid(arm: ArmModel) -> Rigid:
    """An attachment that closes at home except for rotations of joints 1 and n."""
    axis = hinge_at(arm, [0.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    return Rigid(a_0_m=axis.a_0_m, s_0_m=axis.s_0_m, alpha_0_rad=axis.alpha_0_rad, s_1_m=axis.s_1_m)


def hinge_at(arm: ArmModel, point_m: list[float], direction: list[float]) -> Hinge:
    """The hinge on a line of the frame before the last link at home, with the offsets of the arm's file."""
    frames = at_home(arm)
    R, p = frames.axes[-2] @ rotation_about_z(arm.home_rad[-1]), frames.origins_m[-2]
    in_base = Line(point_m=np.array(point_m), direction=np.array(direction)).in_frame(R, p)
    in_tool = in_base.in_frame(frames.R_end.T, -frames.p_end @ frames.R_end)
    placed = Hinge.between(arm, in_base, in_tool)
    return replace(placed, theta_off_1_rad=None, theta_off_n_rad=None)


def measured(arm: ArmModel) -> Measured:
    """A full-pose instrument beside the arm, with a target beside the flange."""
    return Measured(
        full_pose=True,
        base_m=(1.5, -0.4, 0.2),
        base_turn_rad=(0.1, -0.2, 2.0),
        tip_m=EXAMPLE_TIP_M,
        tip_turn_rad=(0.2, 0.1, -0.3),
        sigma_m=20e-6,
        sigma_rad=50e-6,
    )


FIXTURES = {"ball": ball, "hinge": hinge, "measured": measured, "rigid": rigid}
"""The fixtures under contract."""


JOINT = Joint(
    name="joint",
    lower_rad=-10.0,
    upper_rad=10.0,
    sensor=Encoder(counts_per_rev=400_000),
    max_speed_rad_per_s=1.0,
    max_torque_nm=10.0,
)


def sarcos() -> ArmModel:
    """Spherical shoulder and wrist, as in the paper."""
    packaged = load_arm("sarcos_dextrous")
    return replace(packaged, name="sarcos", joints=(JOINT,) * packaged.joint_count)


def eight_joints() -> ArmModel:
    """No two neighbouring axes intersect, so that seven joints or spherical wrists are not assumed."""
    return ArmModel(
        name="eight",
        table=DhTable(
            theta_off_rad=np.deg2rad([5, 10, -20, 30, -10, 0, 20, 10]),
            s_m=[0.3, 0.02, 0.25, -0.03, 0.2, 0.1, 0.02, 0.08],
            a_m=[0.03, 0.1, -0.05, 0.08, 0.04, 0.06, 0.05, 0.0],
            alpha_rad=np.deg2rad([-80, 85, 95, -70, 88, 60, -95, 0]),
        ),
        joints=(JOINT,) * 8,
        free=tuple(DhEntry(DhKind.THETA_OFF, j) for j in range(1, 9)),
        home_rad=np.deg2rad([10, -40, 20, -100, 30, 70, 40, -20]),
        length_tolerance_m=np.zeros(8),
        twist_tolerance_rad=np.zeros(8),
    )


ARMS = {"sarcos": sarcos, "eight": eight_joints}


@dataclass(frozen=True)
class Case:
    """A fixture on an arm, with planted parameters and poses that close exactly."""

    kind: str
    arm: ArmModel
    model: ClosureModel
    truth: np.ndarray
    q: np.ndarray


def observed(model: ClosureModel, x: np.ndarray, q: np.ndarray) -> ClosureModel:
    """Bind an open arm to simulated measurements of its instrument; a closed loop has none."""
    if isinstance(model, MeasuredClosure):
        position, rotation = model.predicted(x, q)
        return model.with_endpoints(position, rotation if model.full_pose else None)
    return model


def closed_poses(
    model: ClosureModel,
    x: np.ndarray,
    arm: ArmModel,
    seed: int,
    *,
    count: int = 30,
    constrained: int | None = None,
) -> np.ndarray:
    """Return poses with inner joints up to 60 deg from home, first and last anywhere, one joint at home on request."""
    rng = np.random.default_rng(seed)
    q = arm.home_rad + rng.uniform(-1.0, 1.0, (12 * count, arm.joint_count))
    q[:, [0, -1]] = rng.uniform(-np.pi, np.pi, (12 * count, 2))
    sigma = np.ones(arm.joint_count)
    if constrained is not None:
        q[:, constrained - 1] = arm.home_rad[constrained - 1]
        sigma[constrained - 1] = 0.0
    if isinstance(model, MeasuredClosure):
        return q[:count]
    poses = close_loops(model, x, q, sigma_rad=sigma, max_iterations=60)
    # Distant solutions belong to another assembly mode of the arm.
    valid = poses.closed & ~model.reduced(x, poses.q).flipped
    valid &= np.abs(poses.q - q).max(-1) < 1.5
    q = poses.q[valid][:count]
    assert len(q) == count, f"only {len(q)} of {count} poses close"
    return q


def perturbed(model: ClosureModel, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    size = np.where([p.is_angle for p in model.parameters], np.deg2rad(5.0), 0.02)
    return nominal_vector(model.parameters) + size * rng.uniform(-1.0, 1.0, len(size))


@cache
def case(kind: str, arm_name: str) -> Case:
    """Return a case whose parameters are all identifiable from its poses."""
    arm = ARMS[arm_name]()
    model = FIXTURES[kind](arm).model(arm)
    x = nominal_vector(model.parameters)
    q = closed_poses(model, x, arm, seed=1)
    model, _ = drop_unidentifiable(observed(model, x, q), x, q)
    if isinstance(model, MeasuredClosure):
        model = replace(model, endpoint_m=None, endpoint_rotation=None)
    truth = perturbed(model, seed=2)
    q = closed_poses(model, truth, arm, seed=3)
    return Case(kind=kind, arm=arm, model=observed(model, truth, q), truth=truth, q=q)
