# ruff: noqa: T201 - a benchmark prints
"""Planned against unplanned poses, and what planning costs. Run: python -m tests.benchmarks.planning

For Table 2's arm (scenario `datasheet`) and wild arms: standard deviations on joints 1-5 and the
hinge's parameters from 12 planned poses over those from 60 random ones, in three senses of random:

session   drive targets at random in the box that an unplanned session uses (procedure `hinge`)
closed    random joint angles around home put on the nearest closed loop, as the data sets were made
region    every pose that the planner could reach is equally likely: no operator could do this
          without the planner, for it takes its knowledge of the whole region
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from time import perf_counter, process_time

import numpy as np

from hardware.virtual.scenarios import scenario
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.procedure_file import load_procedure
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector
from solver.chain.sensors import Rvdt
from solver.closing import close_loops
from solver.design.d_optimal import next_best
from solver.design.drive_line import drive_straight
from solver.design.manifold import Ranges
from solver.design.plan import PlanningTask, information_of, make_plan
from solver.design.pose_information import planning_noise
from solver.design.stop_rule import standard_deviations
from solver.loops.dh import DhLoop
from tests.oracles.loop_oracle import Truth, closed_poses

WRIST = ("theta_off_6", "theta_off_7")
DRIVES = ((1, 5),)


def true_model(name: str, seed: int, arm: ArmModel) -> DhLoop:
    """Loop of a scenario's true geometry, with the unknowns of a hinge calibration."""
    entries = load_fixture("hinge").fixture.model(arm).entries
    return DhLoop(table=scenario(name, seed).true_loop().table, entries=entries, hinge=True)


def planning_task(model: DhLoop, arm: ArmModel, **changes) -> PlanningTask:
    curve = [j.sensor.linearity_rad if isinstance(j.sensor, Rvdt) else 0.0 for j in arm.joints]
    settings = {
        "model": model,
        "ranges": Ranges(lower_rad=arm.lower_rad, upper_rad=arm.upper_rad),
        "margin_rad": np.deg2rad(3.0) + np.array(curve),
        "noise": planning_noise(arm.sigma_rad()),
        "drive_sets": DRIVES,
        **changes,
    }
    return PlanningTask(**settings)


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
    region: float
    condition: float
    plan_s: float


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
    start = perf_counter()
    plan = make_plan(task, x, arm.home_rad, planned)
    took = perf_counter() - start
    judged = [k for k, p in enumerate(plan.information.parameters) if p not in WRIST]
    rng = np.random.default_rng([seed, 60])
    ratios = []
    region = plan.manifold.q[rng.choice(np.flatnonzero(plan.allowed), random, replace=False)]
    for poses in (
        session_poses(model, arm, rng, random),
        random_closed(model, arm, rng, random),
        region,
    ):
        sigma = standard_deviations(information_of(task, x, poses))
        ratios.append(float((plan.predicted_sigma / sigma)[judged].mean()))
    return Comparison(
        session=ratios[0],
        closed=ratios[1],
        region=ratios[2],
        condition=plan.design.scaled_condition_number,
        plan_s=took,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--arms", type=int, default=50, help="wild arms")
    arguments = parser.parse_args()
    arm = load_arm("sarcos_dextrous")

    print("mean relative sigma (joints 1-5 and hinge), 12 planned poses over 60 random ones")
    print("arm            session  closed  region  scaled condition of the 12")
    rows = []
    for name, seed in [("datasheet", 0), *(("wild", k) for k in range(arguments.arms))]:
        row = compare(name, seed, arm)
        print(
            f"{name + ' ' + str(seed):<14} {row.session:7.3f} {row.closed:7.3f} {row.region:7.3f}"
            f"  {row.condition:6.1f}"
        )
        if name == "wild":
            rows.append(row)
    if rows:
        for label, pick in (("median", np.median), ("worst", np.max)):
            session, closed, region, condition = (
                pick([getattr(r, column) for r in rows])
                for column in ("session", "closed", "region", "condition")
            )
            print(f"wild {label:<9} {session:7.3f} {closed:7.3f} {region:7.3f}  {condition:6.1f}")
        for column in ("session", "closed", "region"):
            better = sum(getattr(r, column) < 1.0 for r in rows)
            print(f"better than 60 random ({column}): {better} of {len(rows)} wild arms")

    model = true_model("datasheet", 0, arm)
    x = nominal_vector(model.parameters)
    task = planning_task(model, arm)
    start, cpu = perf_counter(), process_time()
    plan = make_plan(task, x, arm.home_rad, 20)
    took, cpu = perf_counter() - start, process_time() - cpu
    information = information_of(task, x, plan.poses_rad)
    start = perf_counter()
    next_best(plan.information.root, information, allowed=plan.allowed)
    update = perf_counter() - start
    print(f"\nTable 2's arm: {plan.manifold.size} candidates, {plan.allowed.mean():.0%} reachable")
    print(
        f"scaled condition of 20 planned poses: {plan.design.scaled_condition_number:.1f} (<= 18)"
    )
    print(
        f"planning 20 poses: {took:.2f} s, {cpu:.2f} s of processor (< 2); next best pose: {update * 1e3:.1f} ms (< 50)"
    )


if __name__ == "__main__":
    main()
