"""Ways of writing a turn against scipy's own, and names that cannot be mistaken."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from operator_app.config.errors import ConfigError
from operator_app.config.orientation import group_of, groups_in, rotation_vectors
from operator_app.config.poses_file import parse_poses
from tests.oracles.approved import Approve

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
