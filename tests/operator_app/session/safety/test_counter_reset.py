"""A counter that began anew is at zero, or near it where the arm has sagged since; many joints truly stand there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hardware.arm import Reading
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import ConnectAgainError
from operator_app.session.safety.counter_reset import check_counters, counters_near_zero
from operator_app.session.safety.preflight import check_closure_without_poses
from tests.oracles.shop_floor import session

SAGGED_DEG = (0.0, 0.0324, 0.25, 1.0, 4.9)


def _moved_zero(procedure: Procedure, joint: int, by_rad: float) -> Procedure:
    """The same arm, that joint counted from elsewhere."""
    arm, column = procedure.arm, joint - 1
    own = arm.joints[column]
    moved = replace(own, lower_rad=own.lower_rad - by_rad, upper_rad=own.upper_rad - by_rad)
    off, home = arm.table.theta_off_rad.copy(), arm.home_rad.copy()
    off[column] += by_rad
    home[column] -= by_rad
    joints = (*arm.joints[:column], moved, *arm.joints[joint:])
    table = replace(arm.table, theta_off_rad=off)
    return replace(procedure, arm=replace(arm, joints=joints, table=table, home_rad=home))


def _standing(
    q_rad: np.ndarray, joint: int, truly_rad: float, reads_rad: float
) -> tuple[Procedure, Reading]:
    """An arm of which a joint is `truly_rad` from where it counts from, and what it reads."""
    procedure = _moved_zero(load_procedure("hinge"), joint, float(q_rad[joint - 1]) - truly_rad)
    read = q_rad.copy()
    read[joint - 1] = reads_rad
    counts = read / np.array([j.sensor.resolution_rad for j in procedure.arm.joints])
    return procedure, Reading(
        mean_counts=counts, mean_rad=read, sd_rad=np.zeros(7), samples=32, first_sync=1
    )


@pytest.mark.sample(5)
@pytest.mark.parametrize("sagged_deg", SAGGED_DEG)
@pytest.mark.parametrize("joint", [1, 2, 3, 4, 5])
def test_it_is_named_wherever_it_has_sagged_to_and_a_joint_that_is_there_is_not(
    joint: int, sagged_deg: float
) -> None:
    """Arms by the shop floor's generator, within what their files state; that joint 60 deg from zero."""
    for seed, side in ((0, -1.0), (1, 1.0)):
        q, near = session(seed, poses=2).readings[0], side * np.deg2rad(sagged_deg)
        check_closure_without_poses(*_standing(q, joint, near, near))
        where = "at zero" if sagged_deg == 0.0 else "near zero"
        with pytest.raises(ConnectAgainError, match=f"joint {joint} is {where}") as refused:
            check_closure_without_poses(*_standing(q, joint, side * np.deg2rad(60.0), near))
        assert f"Home joint {joint}" in str(refused.value)


def test_of_those_near_zero_the_nearest_comes_first() -> None:
    arm = load_procedure("hinge").arm
    q = np.deg2rad([4.0, 0.03, -0.0004, 30.0, 6.0, 0.0, 0.0])
    found = counters_near_zero(arm, q)
    # Joints 6 and 7 have RVDTs, which lose no count.
    assert list(found) == [3, 2, 1]
    assert found[3] == 1.0
    assert found[2] == pytest.approx(0.03 / (2.5 * 360.0 / 400_000))


@pytest.mark.parametrize(
    ("range_deg", "reads_deg", "refused"),
    [
        ((0.0, 150.0), 0.0, False),
        ((-1e-6, 150.0), 0.0, False),
        ((170.0, 320.0), 0.0324, True),
        ((170.0, 320.0), -4.9, True),
        # On its stop, a little outside what its file says.
        ((1.5, 150.0), 1.0, False),
        ((1.5, 150.0), 0.5, True),
        # Wrong, but not near zero: the loop is asked.
        ((170.0, 320.0), 30.0, False),
    ],
)
def test_nearer_to_zero_than_to_its_range_a_joint_cannot_be(
    range_deg: tuple[float, float], reads_deg: float, refused: bool
) -> None:
    arm = load_procedure("hinge").arm
    lower, upper = np.deg2rad(range_deg)
    joint = replace(arm.joints[0], lower_rad=float(lower), upper_rad=float(upper))
    arm = replace(arm, joints=(joint, *arm.joints[1:]))
    q = arm.home_rad.copy()
    q[0] = np.deg2rad(reads_deg)
    if refused:
        with pytest.raises(ConnectAgainError, match=r"joint 1 reads .*, outside its range"):
            check_counters(arm, q)
    else:
        check_counters(arm, q)
