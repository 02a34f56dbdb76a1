"""The box of the drive joints, and its waypoints."""

import numpy as np
import pytest

from operator_app.planning.exploration import Box, waypoints


def box(lower_rad: tuple[float, ...], upper_rad: tuple[float, ...]) -> Box:
    return Box(joints=(1, 3), centre_rad=(0.0, 0.0), lower_rad=lower_rad, upper_rad=upper_rad)


@pytest.mark.parametrize(
    ("lower", "upper", "positions", "beyond"),
    [
        ((-0.5, -1.2), (0.8, 0.0), (1.0, 9.0, -0.3), (0.2, 0.0)),
        # An empty box, as for joints that start 0.9 rad beyond the end of their range.
        ((1.7, 1.7), (0.9, 0.9), (0.9, 9.0, 1.3), (0.8, 0.4)),
    ],
)
def test_distance_from_the_box_is_zero_inside(lower, upper, positions, beyond):
    assert box(lower, upper).beyond_rad(np.array(positions)) == pytest.approx(beyond)


def test_waypoints_are_cached():
    region = box((-0.5, -1.2), (0.8, 0.0))
    cached = waypoints(region, poses=1000, seed=3)
    assert waypoints(region, poses=1000, seed=3) is cached
    assert waypoints(region, poses=1000, seed=4) != cached
    assert len(cached) == 3000
    with pytest.raises(TypeError):
        cached[0][1] = 9.0
