"""Planned against unplanned poses on a scenario's arm, in two senses of random.

session   drive targets at random in the box that an unplanned session uses (procedure `hinge`)
closed    random joint angles around home put on the nearest closed loop, as the data sets were made
"""

from dataclasses import dataclass

import numpy as np

from hardware.virtual.scenarios import scenario
from operator_app.config.fixture_file import load_fixture
from operator_app.config.procedure_file import load_procedure
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector
from solver.chain.sensors import Rvdt
from solver.closing import close_loops
from solver.design.manifold import Ranges
from solver.design.motion import drive_straight
from solver.design.plan import PlanningTask, make_plan
from solver.design.stop_rule import standard_deviations
from solver.estimators.implicit import NoiseModel
from solver.loops.dh import DhLoop
from tests.oracles.loop_oracle import Truth, closed_poses
from tests.solver.design.conftest import known, of_noise

WRIST = ("theta_off_6", "theta_off_7")
DRIVES = ((1, 5),)


def true_model(name: str, seed: int, arm: ArmModel) -> DhLoop:
    """Loop of a scenario's true geometry, with the unknowns of a hinge calibration."""
    entries = load_fixture("hinge").fixture.model(arm).entries
    return DhLoop(table=scenario(name, seed).true_loop().table, entries=entries, hinge=True)


def planning_task(model: DhLoop, arm: ArmModel, *, candidates: int) -> PlanningTask:
    curve = [j.sensor.linearity_rad if isinstance(j.sensor, Rvdt) else 0.0 for j in arm.joints]
    return PlanningTask(
        model=model,
        ranges=Ranges(lower_rad=arm.lower_rad, upper_rad=arm.upper_rad),
        margin_rad=np.deg2rad(3.0) + np.array(curve),
        noise=NoiseModel(joint_variance=arm.sigma_rad() ** 2),
        errors=of_noise(arm.sigma_rad()),
        drive_sets=DRIVES,
        candidates=candidates,
    )


def session_poses(model: DhLoop, arm: ArmModel, rng: np.random.Generator, count: int) -> np.ndarray:
    """What random drive targets in the unplanned session's box give."""
    x = nominal_vector(model.parameters)
    box = load_procedure("hinge").capture.exploration
    home = close_loops(model, x, arm.home_rad[None, :])
    drives = tuple(b.joint for b in box)
    low, high = (np.array([getattr(b, end) for b in box]) for end in ("lower_rad", "upper_rad"))
    start = home.q[0, [j - 1 for j in drives]]
    targets = start + rng.uniform(low, high, (count, len(drives)))
    lines = drive_straight(
        model,
        x,
        np.repeat(home.q, count, axis=0),
        np.repeat(home.u, count, axis=0),
        drives,
        targets,
        steps=30,
    )
    return lines.q[lines.closed, -1]


def random_closed(model: DhLoop, arm: ArmModel, rng: np.random.Generator, count: int) -> np.ndarray:
    table = model.table
    truth = Truth(
        theta_off=table.theta_off_rad,
        s=table.s_m,
        a=table.a_m,
        alpha=table.alpha_rad,
        home=arm.home_rad,
    )
    return closed_poses(truth, rng, count)[:, 1:]


@dataclass(frozen=True)
class Comparison:
    """Mean relative sigma of the planned poses against each kind of random ones."""

    session: float
    closed: float
    condition: float


def compare(
    name: str,
    seed: int,
    arm: ArmModel,
    *,
    planned: int = 12,
    random: int = 60,
    candidates: int = 3000,
) -> Comparison:
    model = true_model(name, seed, arm)
    x = nominal_vector(model.parameters)
    task = planning_task(model, arm, candidates=candidates)
    plan = make_plan(task, x, arm.home_rad, planned)
    judged = [k for k, p in enumerate(plan.information.parameters) if p not in WRIST]
    rng = np.random.default_rng([seed, 60])
    ratios = []
    for poses in (session_poses(model, arm, rng, random), random_closed(model, arm, rng, random)):
        sigma = standard_deviations(known(task, x, poses))
        ratios.append(float((plan.predicted_sigma / sigma)[judged].mean()))
    return Comparison(
        session=ratios[0], closed=ratios[1], condition=plan.design.scaled_condition_number
    )
