"""Three targets on the hand: poses by SciPy's rotations, a calibration by nine equations a pose."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from fixtures.measured import Measured
from operator_app.calibration.calibrate import calibrate
from operator_app.config.arm_file import load_arm
from operator_app.config.errors import ConfigError
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import parse_poses
from operator_app.config.three_targets import TARGETS, poses_of_targets
from solver.chain.kinematics import DhTable

TRIANGLE = np.array([[0.10, 0.0, 0.05], [-0.05, 0.09, 0.04], [-0.06, -0.07, 0.02]])
LABELS = [str(k) for k in range(1, 41)]


def seen(rng: np.random.Generator, count: int, sigma_m: float = 0.0):
    """Targets (m, 9) on a hand at random places, and where it is: rotations and points (m, 3)."""
    turn, place = Rotation.random(count, random_state=rng), rng.uniform(-1.0, 1.0, (count, 3))
    points = np.einsum("mij,kj->mki", turn.as_matrix(), TRIANGLE) + place[:, None, :]
    return (points + sigma_m * rng.standard_normal(points.shape)).reshape(count, 9), turn, place


def test_the_frame_of_the_targets_is_fixed_to_the_hand() -> None:
    points, turn, place = seen(np.random.default_rng(1), 20)
    found = poses_of_targets(points, LABELS)
    own = turn.inv() * Rotation.from_rotvec(found[:, 3:])
    assert (own * own[0].inv()).magnitude().max() < 1e-12
    origin = turn.inv().apply(found[:, :3] - place)
    assert origin == pytest.approx(np.tile(TRIANGLE.mean(axis=0), (20, 1)), abs=1e-12)
    # x goes from the centroid to target 1, z is normal to the triangle.
    x, _, z = own[0].as_matrix().T
    assert x @ (TRIANGLE[0] - TRIANGLE.mean(axis=0)) == pytest.approx(
        np.linalg.norm(TRIANGLE[0] - TRIANGLE.mean(axis=0))
    )
    assert z @ np.cross(TRIANGLE[1] - TRIANGLE[0], TRIANGLE[2] - TRIANGLE[0]) > 0.0
    assert abs(z @ (TRIANGLE[1] - TRIANGLE[0])) < 1e-12


def test_its_noise_is_that_of_the_triangle() -> None:
    points, turn, place = seen(np.random.default_rng(2), 400, sigma_m=1e-4)
    found = poses_of_targets(points, [str(k) for k in range(400)])
    own = turn.inv() * Rotation.from_rotvec(found[:, 3:])
    turned = (own.mean().inv() * own).as_rotvec().std(axis=0)
    moved = (found[:, :3] - place - turn.apply(TRIANGLE.mean(axis=0))).std()
    assert moved == pytest.approx(1e-4 / np.sqrt(3.0), rel=0.1)
    flat = TRIANGLE - TRIANGLE.mean(axis=0)
    assert turned[2] == pytest.approx(1e-4 / np.linalg.norm(flat), rel=0.1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda p: p[6, 3:6].__iadd__(0.02), "pose 7: its targets are"),
        (lambda p: p[6].__setitem__(slice(None), np.roll(p[6], 3)), "pose 7: its targets are"),
        (lambda p: p.__setitem__((slice(None), slice(3, 9)), np.tile(p[:, :3], 2)), "in line"),
    ],
)
def test_a_target_that_moved_and_targets_in_line_are_refused(change, words: str) -> None:
    points, *_ = seen(np.random.default_rng(3), 12)
    change(points)
    with pytest.raises(ValueError, match=words):
        poses_of_targets(points, LABELS)


def csv(q: np.ndarray, points: np.ndarray, columns: tuple[str, ...] = TARGETS) -> str:
    head = ["placement", "pose", *(f"theta{j + 1}_deg" for j in range(q.shape[1])), *columns]
    rows = [
        [1, k + 1, *np.rad2deg(a).tolist(), *p[: len(columns)].tolist()]
        for k, (a, p) in enumerate(zip(q, points, strict=True))
    ]
    return "\n".join(",".join(map(str, row)) for row in [head, *rows]) + "\n"


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        (TARGETS[:-1], "z3_m: this column is missing"),
        ((*TARGETS[:8], "x_m"), "x_m: the three targets say where the hand is"),
    ],
)
def test_columns_that_are_not_three_targets_are_named(columns: tuple[str, ...], words: str) -> None:
    points, *_ = seen(np.random.default_rng(4), 5)
    text = csv(np.full((5, 7), 0.1), points, columns)
    with pytest.raises(ConfigError, match=re.escape(words)):
        parse_poses(text.encode(), "p.csv")


SIGMA_M = 5e-5


def rotations(axis: int, angle: np.ndarray) -> np.ndarray:
    return Rotation.from_rotvec(np.eye(3)[axis] * angle[:, None]).as_matrix()


def targets_of(
    t: DhTable, offsets: np.ndarray, base: np.ndarray, points: np.ndarray, q: np.ndarray
):
    """Targets (m, 3, 3) by plain matrices: base turn and place, an arm of the table, points on the hand."""
    R = np.tile(Rotation.from_rotvec(base[:3]).as_matrix(), (len(q), 1, 1))
    p = np.tile(base[3:], (len(q), 1))
    for j in range(q.shape[1]):
        R = R @ rotations(2, q[:, j] + offsets[j])
        p = p + R @ np.array([t.a_m[j], 0.0, 0.0]) + R[:, :, 2] * t.s_m[j]
        R = R @ rotations(0, np.full(len(q), t.alpha_rad[j]))
    return np.einsum("mij,kj->mki", R, points) + p[:, None, :]


@pytest.fixture(scope="module")
def measured():
    """Readings of an arm with unknown offsets (m, n), its targets (m, 9), and the true offsets (n,)."""
    arm, rng = load_arm("franka_fr3"), np.random.default_rng(5)
    q = rng.uniform(0.8 * arm.lower_rad, 0.8 * arm.upper_rad, (40, 7))
    nominal = arm.table.theta_off_rad
    true = nominal + np.deg2rad(rng.uniform(-1.0, 1.0, 7))
    base = np.array([0.1, -0.2, 2.0, 1.5, -0.4, 0.2])
    points = targets_of(arm.table, true, base, TRIANGLE, q).reshape(40, 9)
    return arm, q, points + SIGMA_M * rng.standard_normal(points.shape), true, base


def nine_equations(arm, q, points, true, base):
    """Offsets 2 to 6 and their standard deviations, each target with its own place on the hand."""

    def misclosure(x: np.ndarray) -> np.ndarray:
        offsets = np.array([true[0], *x[:5], true[6]])
        found = targets_of(arm.table, offsets, x[5:11], x[11:].reshape(3, 3), q)
        return (found.reshape(40, 9) - points).ravel() / SIGMA_M

    start = np.concatenate((arm.table.theta_off_rad[1:6], base, TRIANGLE.ravel()))
    found = least_squares(misclosure, start, x_scale="jac", xtol=1e-15, ftol=1e-15)
    return found.x[:5], np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))[:5]


def test_a_calibration_finds_what_nine_equations_a_pose_find(measured) -> None:
    arm, q, points, true, base = measured
    values, sigmas = nine_equations(arm, q, points, true, base)
    poses = parse_poses(csv(q, points).encode(), "targets.csv").poses
    fixture = load_fixture("tracker").fixture
    assert isinstance(fixture, Measured)
    side = np.linalg.norm(TRIANGLE[0] - TRIANGLE[1])
    stated = replace(
        fixture, sigma_m=SIGMA_M / np.sqrt(3.0), sigma_rad=np.sqrt(2.0) * SIGMA_M / side
    )
    joints = [
        replace(j, backlash_rad=0.0, sag_rad=0.0, sensor=replace(j.sensor, accuracy_rad=0.0))
        for j in arm.joints
    ]
    exact = replace(arm, tolerances=(), joints=tuple(joints))
    solution = calibrate(exact, stated, poses)
    names = [p.name for p in solution.model.parameters]
    found = np.array([solution.estimate.x[names.index(f"theta_off_{j}")] for j in range(2, 7)])
    assert np.abs((found - values) / sigmas).max() < 0.4
    assert np.abs((found - true[1:6]) / sigmas).max() < 3.0
