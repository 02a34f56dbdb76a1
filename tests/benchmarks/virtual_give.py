# ruff: noqa: E402, T201 - threads are limited before NumPy starts; a benchmark prints
"""What known masses bring on the virtual plant, whose hinge gives. Run: python -m tests.benchmarks.virtual_give

The plant is in equilibrium by itself: masses that its drives do not compensate, dry friction, stiff
drives, a hinge with a stiffness of about 0.2 mm of give. Joints 1 and 5 drive through the shipped box.
Every specimen is calibrated with the packaged arm file and with the same file without masses; once as it
is, and once with every other source stated to be exact, as on this plant it is. The files' masses are
not the plant's: those sit at the elbow and the wrist and are not in the file at all.
"""

from __future__ import annotations

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import argparse
from dataclasses import replace

import numpy as np

from hardware.virtual.scenarios import Loads, Scenario, scenario
from operator_app.calibration.calibrate import calibrate
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from solver.arrays import frozen
from solver.chain.arm_model import ArmModel, Joint
from solver.chain.parameters import nominal_vector, wrap_angles
from solver.chain.poses import PoseSet
from solver.chain.sensors import Encoder
from solver.loops.closure import nearest_equivalent
from solver.loops.dh import DhLoop
from tests.oracles.planned_session import SAMPLES, PlantSession

BOX_DEG = ((-30.0, 48.0), (-70.0, 0.0))
BENDS = Loads(
    fixture_n_per_m=1.0e5,
    fixture_nm_per_rad=5.0e3,
    friction_nm=frozen([0.6, 0.6, 0.5, 0.5, 0.3, 0.2, 0.2]),
    payload_kg=frozen([0.0, 0.0, 4.0, 0.0, 4.0, 0.0, 0.0]),
)
SOURCES = ("as shipped", "give alone stated")


def taken(described: Scenario, arm: ArmModel, count: int) -> tuple[PoseSet, float]:
    """Poses of one specimen, and the rms displacement of its hinge, m."""
    session = PlantSession(described, arm, (1, 5))
    rng = np.random.default_rng([described.seed, 9])
    home, low = session.q.copy(), np.deg2rad([b[0] for b in BOX_DEG])
    high = np.deg2rad([b[1] for b in BOX_DEG])
    q, give = [], []
    while len(q) < count:
        goal = home[[0, 4]] + rng.uniform(low, high)
        if session.move({1: float(goal[0]), 5: float(goal[1])}, lambda _: ""):
            session.set_drives((1, 5))
            continue
        q.append(session.capture())
        give.append(session.plant.closure_error[3:])
    labels = tuple(f"p{k:03d}" for k in range(count))
    ones = np.ones(count, dtype=np.int64)
    poses = PoseSet(placement=ones, label=labels, q_rad=np.array(q), samples=SAMPLES * ones)
    return poses, float(np.sqrt(np.mean(np.square(give))))


def exact_but_for_give(arm: ArmModel) -> ArmModel:
    """The arm with every source but the hinge's give and the sensors' noise stated as none."""

    def joint(one: Joint) -> Joint:
        sensor = one.sensor
        if isinstance(sensor, Encoder):
            sensor = replace(sensor, accuracy_rad=0.0)
        return replace(one, sensor=sensor, backlash_rad=0.0, sag_rad=0.0)

    return replace(arm, joints=tuple(map(joint, arm.joints)), tolerances=())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument("--arms", type=int, default=10)
    parser.add_argument("--poses", type=int, default=40)
    options = parser.parse_args()
    packaged, hinge = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
    errors: dict[tuple[str, bool], list[np.ndarray]] = {}
    gives = []
    for seed in range(options.arms):
        described = replace(scenario("datasheet", seed), specimen=seed, loads=BENDS)
        poses, give = taken(described, packaged, options.poses)
        gives.append(give)
        for source, arm in zip(SOURCES, (packaged, exact_but_for_give(packaged)), strict=True):
            for loads in (False, True):
                one = arm if loads else replace(arm, masses=None)
                found = calibrate(one, hinge, poses).identified
                entries = DhLoop(
                    table=described.true_loop().table,
                    entries=tuple(e for e in hinge.model(one).entries),
                    hinge=True,
                )
                true = nominal_vector(entries.parameters)
                x = nearest_equivalent(entries, found.x, true)
                off = wrap_angles(entries.parameters, x - true)
                errors.setdefault((source, loads), []).append(
                    np.stack((off, off / found.standard_deviation))
                )
    print(f"{options.arms} arms, hinge gives {1e3 * np.sqrt(np.mean(np.square(gives))):.2f} mm rms")
    for (source, loads), values in errors.items():
        off, z = np.array(values).transpose(1, 0, 2)
        print(
            f"{source:18} {'masses known' if loads else 'no masses':13} rms error of offsets 1-5 "
            f"{np.rad2deg(np.sqrt(np.mean(off[:, :5] ** 2))):.4f} deg, lengths "
            f"{1e3 * np.sqrt(np.mean(off[:, [7, 8, 10, 11, 12]] ** 2)):.3f} mm, cover "
            f"{100 * np.mean(np.abs(z) < 1.96):.0f} %, rms z {np.sqrt(np.mean(z**2)):.2f}"
        )


if __name__ == "__main__":
    main()
