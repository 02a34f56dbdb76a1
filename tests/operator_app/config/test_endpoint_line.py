"""What an instrument may say in a line, and what is refused in words."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from operator_app.config.endpoint_line import (
    BadLine,
    endpoint_schema,
    read_json_line,
    read_row,
    require_heading,
)
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


def test_the_schema_knows_every_name() -> None:
    text = json.dumps(endpoint_schema())
    for name in ("x_m", "rx_deg", "yaw_deg", "qz", "euler_", "lost", "pose"):
        assert name in text
