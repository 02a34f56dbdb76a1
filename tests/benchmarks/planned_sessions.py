# ruff: noqa: T201 - a benchmark prints
"""Whole planned sessions on the virtual plant. Run: python -m tests.benchmarks.planned_sessions

Every session starts from the nominal model, explores, calibrates, plans and visits 12 poses on an arm
it does not know. Counted: joints that left their range, speed and torque trips, moves the session
itself had to stop, poses that do not close; and how well the arm is known in the end.
"""

from __future__ import annotations

import argparse
from time import perf_counter

import numpy as np

from hardware.virtual.scenarios import scenario
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector, wrap_angles
from solver.chain.sensors import Rvdt
from solver.design.campaign import Campaign, CampaignSettings
from solver.design.manifold import Ranges
from solver.design.plan import PlanningTask
from solver.design.pose_information import planning_noise
from solver.loops.closure import nearest_equivalent
from solver.loops.dh import DhLoop
from tests.oracles.planned_session import PlantSession, Record, run_campaign

CLOSED = 1e-6
"""Closure error (rad, m) of a pose that closes in a stiff fixture."""


def run_session(
    name: str, seed: int, arm: ArmModel, *, poses: int = 12, candidates: int = 3000
) -> tuple[Record, np.ndarray]:
    """One session: its record, and the error of every parameter against the truth (rad, m)."""
    described = scenario(name, seed)
    carried = described.arm(arm)
    model = load_fixture("hinge").fixture.model(carried)
    curve = np.array(
        [j.sensor.linearity_rad if isinstance(j.sensor, Rvdt) else 0.0 for j in carried.joints]
    )
    task = PlanningTask(
        model=model,
        ranges=Ranges(lower_rad=carried.lower_rad, upper_rad=carried.upper_rad),
        margin_rad=np.deg2rad(3.0) + curve,
        noise=planning_noise(carried.sigma_rad(), wrist_curve_rad=0.5 * curve),
        drive_sets=((1, 5), (2, 5), (2, 3)),
        candidates=candidates,
        seed=seed,
    )
    session = PlantSession(described, arm, (1, 5))
    campaign = Campaign(task=task, start_rad=session.q, settings=CampaignSettings(poses=poses))
    record = run_campaign(session, campaign)
    truth = DhLoop(table=described.true_loop().table, entries=model.entries, hinge=True)
    true = nominal_vector(truth.parameters)
    if campaign.estimate is None:
        return record, np.full(len(true), np.nan)
    found = nearest_equivalent(truth, campaign.estimate.x, true)
    return record, wrap_angles(truth.parameters, found - true)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--scenario", default="wild")
    arguments = parser.parse_args()
    arm = load_arm("sarcos_dextrous")
    trips, stops, complete, open_poses, seconds, errors = 0, 0, 0, 0, [], []
    for seed in range(arguments.first, arguments.first + arguments.sessions):
        start = perf_counter()
        record, error = run_session(arguments.scenario, seed, arm)
        seconds.append(perf_counter() - start)
        ended = record.finished
        trips += bool(record.trips)
        stops += len(record.stops)
        open_poses += record.worst_closure > CLOSED
        complete += ended is not None and ended.complete
        errors.append(np.abs(error))
        print(
            f"{arguments.scenario} {seed:3d}: {record.explored:2d} explored {record.planned:2d} planned"
            f" {record.changes} changes | room {np.rad2deg(record.least_room_rad):5.2f} deg"
            f" speed {np.rad2deg(record.top_speed_rad_per_s):5.1f} deg/s"
            f" torque {record.top_torque_nm:5.1f} N m closure {record.worst_closure:.0e}"
            f" | joints 1-5 {np.abs(error[:5]).max() * 1e3:6.3f} mrad"
            f" | {'; '.join(sorted(set(record.trips)) + record.stops)}"
            f"{'' if ended is None or ended.complete else ' INCOMPLETE: ' + ended.text}"
            f"{' NO END' if ended is None else ''}",
            flush=True,
        )
    worst = np.array(errors)[:, :5].max(axis=1) * 1e3
    print(f"\n{arguments.sessions} sessions on {arguments.scenario} arms")
    print(f"with a joint out of range, or a speed or torque trip: {trips}")
    print(f"with a captured pose that does not close: {open_poses}")
    print(f"moves stopped by the session's own watch: {stops}")
    print(f"all planned poses taken: {complete}")
    print(
        f"largest error on joints 1-5, mrad: median {np.median(worst):.3f}, worst {worst.max():.3f}"
    )
    print(f"seconds a session: median {np.median(seconds):.1f}, longest {max(seconds):.1f}")


if __name__ == "__main__":
    main()
