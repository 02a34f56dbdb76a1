"""Measured endpoints: lines and columns of an instrument, three targets, and what is refused."""

import json
from itertools import product

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from operator_app.config.errors import ConfigError
from operator_app.config.measured_endpoints import (
    TARGETS,
    BadLine,
    group_of,
    groups_in,
    poses_of_targets,
    read_json_line,
    read_row,
    require_heading,
    rotation_vectors,
)
from operator_app.config.poses_file import parse_poses

POINT = {"x_m": 1.25, "y_m": -0.5, "z_m": 0.75}


def test_json_line_is_a_point_with_optional_rotation_or_a_loss():
    point = read_json_line(json.dumps({"pose": 12, **POINT}))
    assert (point.pose, point.endpoint.tolist()) == ("12", [1.25, -0.5, 0.75])
    rotated = read_json_line(json.dumps({**POINT, "rx_deg": 10, "ry_deg": -20, "rz_deg": 90}))
    assert rotated.pose == ""
    assert np.rad2deg(rotated.endpoint[3:]) == pytest.approx([10, -20, 90])
    angles = {"euler_zyx_1_deg": 170, "euler_zyx_2_deg": 80, "euler_zyx_3_deg": -160}
    euler = read_json_line(json.dumps({**POINT, **angles})).endpoint[3:]
    assert matrix(euler) == pytest.approx(rotate_about("zyx", [170, 80, -160]), abs=1e-12)
    assert read_json_line('{"pose": "3", "lost": "no line of sight"}').lost == "no line of sight"


def test_csv_row_is_read_by_its_complete_heading():
    heading = "pose,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg"
    require_heading(heading)
    row = read_row(heading, "7, 1.25,-0.5,0.75, 10,20,30")
    assert row.pose == "7"
    assert matrix(row.endpoint[3:]) == pytest.approx(rotate_about("zyx", [30, 20, 10]), abs=1e-12)
    with pytest.raises(BadLine, match="has no z_m"):
        require_heading("pose,x_m,y_m")
    with pytest.raises(BadLine, match="2 cells for 3 columns"):
        read_row("x_m,y_m,z_m", "1,2")


@pytest.mark.parametrize(
    "line",
    [
        "1.0 2.0 3.0",
        "[1, 2, 3]",
        '{"x_m": 1, "y_m": 2}',
        '{"x_mm": 1250, "y_m": 2, "z_m": 3}',
        '{"x_m": 1250, "y_m": 2, "z_m": 3}',
        '{"x_m": 1, "y_m": 2, "z_m": NaN}',
        '{"x_m": 1, "y_m": true, "z_m": 3}',
        '{"x_m": 1, "y_m": 2, "z_m": 3, "rx_deg": 4}',
        '{"x_m": 1, "y_m": 2, "z_m": 3, "rx_rad": 4}',
        '{"x_m": 1, "y_m": 2, "z_m": 3, "rx_deg": 170, "ry_deg": 80, "rz_deg": -160}',
        '{"x_m": 1, "y_m": 2, "z_m": 3, "qw": 1, "qx": 1, "qy": 0, "qz": 0}',
        '{"x_m": 1, "y_m": 2, "z_m": 3, "yaw_dg": 4}',
        '{"error": "laser off"}',
        pytest.param("[" * 60_000, id="deep"),
        pytest.param(f'{{"x_m": 1{"0" * 400}, "y_m": 2, "z_m": 3}}', id="huge"),
    ],
)
def test_invalid_json_line_is_refused(line, approve):
    with pytest.raises(BadLine) as caught:
        read_json_line(line)
    approve(str(caught.value))


ORDERS = [
    "".join(axes) for axes in product("xyz", repeat=3) if axes[0] != axes[1] and axes[1] != axes[2]
]


def matrix(vector):
    return expm(np.cross(vector, np.eye(3)).T)


def rotate_about(axes, degrees):
    """Intrinsic rotations, one after the other."""
    turns = [np.deg2rad(d) * np.eye(3)["xyz".index(a)] for a, d in zip(axes, degrees, strict=True)]
    return matrix(turns[0]) @ matrix(turns[1]) @ matrix(turns[2])


@pytest.mark.parametrize("order", [*ORDERS, ""])
def test_euler_angles_are_intrinsic_and_roll_pitch_yaw_extrinsic(order):
    group = group_of(f"euler_{order}_2_deg" if order else "pitch_deg")
    assert not order or group == tuple(f"euler_{order}_{k}_deg" for k in (1, 2, 3))
    for angles in np.random.default_rng(5).uniform(-170.0, 170.0, (5, 3)):
        expected = rotate_about(order, angles) if order else rotate_about("zyx", angles[::-1])
        (vector,) = rotation_vectors(group, angles[None])
        np.testing.assert_allclose(matrix(vector), expected, rtol=0, atol=1e-12)


def test_both_signs_of_a_quaternion_are_one_rotation():
    unknown = ("euler_zzy_1_deg", "euler_zyx_4_deg", "euler_abc_1_deg", "rz_rad")
    assert [group_of(name) for name in unknown] == [None] * 4
    group = group_of("qx")
    assert group == ("qw", "qx", "qy", "qz")
    vector = np.array([0.3, -1.0, 2.0])
    half = 0.5 * np.linalg.norm(vector)
    q = np.array([[np.cos(half), *(np.sin(half) * vector / (2.0 * half))]])
    for sign in (1.0, -1.0):
        assert rotation_vectors(group, sign * q) == pytest.approx(vector[None])
    assert np.array_equal(rotation_vectors(group, np.array([[1.0, 0, 0, 0]])), np.zeros((1, 3)))


def parse(columns, rows):
    """The poses of a file with these columns of the endpoint, one row for each pose."""
    lines = ["placement,pose,theta1_deg," + columns]
    lines += [f"1,{k},{10 * k}.5," + ",".join(map(repr, row)) for k, row in enumerate(rows, 1)]
    return parse_poses("\n".join(lines).encode(), "poses.csv")


def test_poses_file_accepts_euler_angles_in_their_own_columns():
    euler = "x_m,y_m,z_m,euler_zyz_1_deg,euler_zyz_2_deg,euler_zyz_3_deg"
    parsed = parse(euler, [(1, 2, 3, 10, 20, 30), (1, 2, 3, -100, 40, 170)])
    rotation = matrix(parsed.poses.endpoint[1, 3:])
    assert rotation == pytest.approx(rotate_about("zyz", [-100, 40, 170]), abs=1e-12)
    assert not parsed.warnings
    suspected = parse("x_m,y_m,z_m,rx_deg,ry_deg,rz_deg", [(1, 2, 3, 170, 80, -160)])
    assert [w.code for w in suspected.warnings] == ["EULER_SUSPECTED"]


@pytest.mark.parametrize(
    "names",
    [
        "x_m,y_m,z_m,roll_deg,pitch_deg",
        "roll_deg,pitch_deg,yaw_deg",
        "x_m,y_m,z_m,rx_deg,ry_deg,rz_deg,qw,qx,qy,qz",
        "x_m,y_m,z_m,euler_zzx_1_deg",
        "x_mm,y_m,z_m",
        ",".join(TARGETS[:-1]),
        ",".join((*TARGETS[:8], "x_m")),
    ],
)
def test_incomplete_or_doubled_endpoint_is_refused(names, approve):
    columns = names.split(",")
    with pytest.raises(ConfigError) as caught:
        parse(names, [[0.5] * len(columns)])
    approve(str(caught.value))
    assert len(groups_in(columns)) <= 2


TRIANGLE = np.array([[0.10, 0.0, 0.05], [-0.05, 0.09, 0.04], [-0.06, -0.07, 0.02]])
LABELS = [str(k) for k in range(1, 41)]


def random_targets(rng, count):
    """Targets (m, 9) on a tool at random poses; rotations and positions (m, 3) of these poses."""
    rotation = Rotation.random(count, random_state=rng)
    position = rng.uniform(-1.0, 1.0, (count, 3))
    points = np.einsum("mij,kj->mki", rotation.as_matrix(), TRIANGLE) + position[:, None, :]
    return points.reshape(count, 9), rotation, position


def test_target_frame_is_fixed_to_the_tool():
    points, rotation, position = random_targets(np.random.default_rng(1), 20)
    poses_6d = poses_of_targets(points, LABELS)
    relative = rotation.inv() * Rotation.from_rotvec(poses_6d[:, 3:])
    assert (relative * relative[0].inv()).magnitude().max() < 1e-12
    origin = rotation.inv().apply(poses_6d[:, :3] - position)
    assert origin == pytest.approx(np.tile(TRIANGLE.mean(axis=0), (20, 1)), abs=1e-12)
    # Axis x points from the centroid to target 1, z is normal to the triangle.
    x, _, z = relative[0].as_matrix().T
    assert x @ (TRIANGLE[0] - TRIANGLE.mean(axis=0)) == pytest.approx(
        np.linalg.norm(TRIANGLE[0] - TRIANGLE.mean(axis=0))
    )
    assert z @ np.cross(TRIANGLE[1] - TRIANGLE[0], TRIANGLE[2] - TRIANGLE[0]) > 0.0
    assert abs(z @ (TRIANGLE[1] - TRIANGLE[0])) < 1e-12
    parsed = parse(",".join(TARGETS), points.tolist()).poses
    np.testing.assert_allclose(parsed.endpoint, poses_6d, rtol=0, atol=1e-15)


def test_moved_or_collinear_targets_are_refused():
    points, *_ = random_targets(np.random.default_rng(3), 12)
    moved, exchanged, collinear = points.copy(), points.copy(), points.copy()
    moved[6, 3:6] += 0.02
    exchanged[6] = np.roll(points[6], 3)
    collinear[:, 3:] = np.tile(points[:, :3], 2)
    for invalid, message in (
        (moved, "pose 7: its targets differ by"),
        (exchanged, "pose 7: its targets differ by"),
        (collinear, "in line"),
    ):
        with pytest.raises(ValueError, match=message):
            poses_of_targets(invalid, LABELS)
