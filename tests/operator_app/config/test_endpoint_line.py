"""What an instrument may say in a line, and what is refused in words."""

from __future__ import annotations

import json
from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from operator_app.config.endpoint_line import (
    BadLine,
    group_of,
    groups_in,
    read_json_line,
    read_row,
    require_heading,
    rotation_vectors,
)
from operator_app.config.errors import ConfigError
from operator_app.config.poses_file import parse_poses
from tests.oracles.approved import Approve

POINT = {"x_m": 1.25, "y_m": -0.5, "z_m": 0.75}


def test_a_line_is_a_point_or_a_point_and_a_turn() -> None:
    found = read_json_line(json.dumps({"pose": 12, **POINT}))
    assert (found.pose, found.endpoint.tolist()) == ("12", [1.25, -0.5, 0.75])
    turned = read_json_line(json.dumps({**POINT, "rx_deg": 10, "ry_deg": -20, "rz_deg": 90}))
    assert (turned.pose, np.rad2deg(turned.endpoint[3:]).tolist()) == (
        "",
        pytest.approx([10, -20, 90]),
    )
    angles = {"euler_zyx_1_deg": 170, "euler_zyx_2_deg": 80, "euler_zyx_3_deg": -160}
    euler = read_json_line(json.dumps({**POINT, **angles})).endpoint[3:]
    wanted = Rotation.from_euler("ZYX", [170, 80, -160], degrees=True)
    assert (Rotation.from_rotvec(np.array(euler)) * wanted.inv()).magnitude() < 1e-12


def test_a_row_says_the_same_below_its_heading() -> None:
    heading = "pose,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg"
    require_heading(heading)
    found = read_row(heading, "7, 1.25,-0.5,0.75, 10,20,30")
    wanted = Rotation.from_euler("xyz", [10, 20, 30], degrees=True)
    assert found.pose == "7"
    assert (Rotation.from_rotvec(np.array(found.endpoint[3:])) * wanted.inv()).magnitude() < 1e-12


def test_a_target_out_of_sight_is_said_with_the_reason() -> None:
    assert read_json_line('{"pose": "3", "lost": "no line of sight"}').lost == "no line of sight"


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
def test_what_is_no_measurement_is_refused_in_words(line: str, approve: Approve) -> None:
    with pytest.raises(BadLine) as caught:
        read_json_line(line)
    approve(str(caught.value))


def test_a_heading_without_a_point_is_refused_before_any_row() -> None:
    with pytest.raises(BadLine, match="has no z_m"):
        require_heading("pose,x_m,y_m")
    with pytest.raises(BadLine, match="2 cells below 3 columns"):
        read_row("x_m,y_m,z_m", "1,2")


RNG = np.random.default_rng(5)
ORDERS = [
    "".join(axes) for axes in product("xyz", repeat=3) if axes[0] != axes[1] and axes[1] != axes[2]
]


def same(found: np.ndarray, wanted: Rotation) -> bool:
    return bool(
        np.allclose(
            (Rotation.from_rotvec(np.array(found)) * wanted.inv()).magnitude(), 0, atol=1e-9
        )
    )


@pytest.mark.parametrize("order", ORDERS)
def test_euler_angles_turn_about_moving_axes_in_the_order_of_their_name(order: str) -> None:
    angles = RNG.uniform(-170.0, 170.0, (20, 3))
    group = group_of(f"euler_{order}_2_deg")
    assert group == tuple(f"euler_{order}_{k}_deg" for k in (1, 2, 3))
    wanted = Rotation.from_euler(order.upper(), angles, degrees=True)
    assert same(rotation_vectors(group, angles), wanted)


def test_roll_pitch_and_yaw_turn_about_fixed_axes() -> None:
    angles = RNG.uniform(-170.0, 170.0, (20, 3))
    group = group_of("pitch_deg")
    assert group is not None
    assert same(rotation_vectors(group, angles), Rotation.from_euler("xyz", angles, degrees=True))


def test_a_quaternion_of_either_sign_is_the_same_turn() -> None:
    turns = Rotation.random(20, random_state=1)
    q = turns.as_quat(scalar_first=True)
    group = group_of("qx")
    assert group == ("qw", "qx", "qy", "qz")
    for sign in (1.0, -1.0):
        found = rotation_vectors(group, sign * q)
        assert same(found, turns)
        assert np.linalg.norm(found, axis=1).max() <= np.pi + 1e-9
    assert np.array_equal(rotation_vectors(group, np.array([[1.0, 0, 0, 0]])), np.zeros((1, 3)))
    with pytest.raises(ValueError, match="has length 1"):
        rotation_vectors(group, 1.1 * q)


@pytest.mark.parametrize(
    "name", ["euler_zzy_1_deg", "euler_zyx_4_deg", "euler_abc_1_deg", "rz_rad"]
)
def test_what_names_no_turn_is_none(name: str) -> None:
    assert group_of(name) is None


def poses(columns: str, *cells: str) -> bytes:
    lines = ["placement,pose,theta1_deg," + columns]
    lines += [f"1,{k},{10 * k}.5," + cell for k, cell in enumerate(cells, 1)]
    return "\n".join(lines).encode()


def test_a_poses_file_may_name_any_of_them() -> None:
    angles = np.array([[10.0, 20.0, 30.0], [-100.0, 40.0, 170.0]])
    cells = [f"1,2,3,{a:g},{b:g},{c:g}" for a, b, c in angles]
    names = "x_m,y_m,z_m,euler_zyz_1_deg,euler_zyz_2_deg,euler_zyz_3_deg"
    found = parse_poses(poses(names, *cells), "poses.csv")
    assert found.poses.endpoint is not None
    assert same(found.poses.endpoint[:, 3:], Rotation.from_euler("ZYZ", angles, degrees=True))
    assert not found.warnings


def test_euler_angles_called_a_rotation_vector_are_suspected() -> None:
    found = parse_poses(poses("x_m,y_m,z_m,rx_deg,ry_deg,rz_deg", "1,2,3,170,80,-160"), "poses.csv")
    assert [w.code for w in found.warnings] == ["EULER_SUSPECTED"]


@pytest.mark.parametrize(
    "names",
    [
        "x_m,y_m,z_m,roll_deg,pitch_deg",
        "roll_deg,pitch_deg,yaw_deg",
        "x_m,y_m,z_m,rx_deg,ry_deg,rz_deg,qw,qx,qy,qz",
        "x_m,y_m,z_m,euler_zzx_1_deg",
        "x_mm,y_m,z_m",
    ],
)
def test_half_a_turn_or_two_of_them_are_refused(names: str, approve: Approve) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_poses(poses(names, ",".join("1" for _ in names.split(","))), "poses.csv")
    approve(str(caught.value))
    assert len(groups_in(names.split(","))) <= 2
