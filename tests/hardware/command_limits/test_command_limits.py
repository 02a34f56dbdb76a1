import itertools
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware.arm import DriveState, JointMode
from hardware.arm_description import JointScale
from hardware.command_limits import (
    JointLimits,
    joint_limits,
    refuse_command,
    refuse_move,
    refuse_target,
)

LIMITS = JointLimits(
    joint=4, lower_counts=-1000, upper_counts=500, max_speed_rad_per_s=2.0, max_step_counts=20
)
NAN, INF = math.nan, math.inf
OUTSIDE, STEP = "is outside -1000 .. 500", "the step of"
NOT_FINITE, SPEED = "is not a finite", "is not valid"


def is_refused(refusal: str, words: str) -> bool:
    """Whether a refusal has these words; for no words, whether there is none."""
    return refusal.startswith("joint 4") and words in refusal if words else refusal == ""


@pytest.mark.parametrize(
    ("words", "steps"),
    [
        ("", [(-1000, -1000), (-999, -1000), (500, 500), (499, 500), (480, 500)]),
        ("", [(0, 20), (0, -20), (20, 0)]),
        (OUTSIDE, [(-999, -1001), (-1000, -1001), (500, 501), (500, 500.001)]),
        # A joint outside its range may move towards it; no command may keep it there or move it away.
        ("", [(520, 519), (520, 500), (-1010, -1009)]),
        (OUTSIDE, [(520, 520), (520, 521), (-1010, -1011)]),
        (STEP, [(0, 21), (0, -21), (521, 500), (0, 20.5)]),
        (NOT_FINITE, [(0, NAN), (0, INF), (0, -INF), (NAN, 0)]),
    ],
)
def test_target_boundaries(words, steps):
    for previous, target in steps:
        assert is_refused(refuse_target(LIMITS, target, previous), words), (previous, target)


@pytest.mark.parametrize(
    ("words", "moves"),
    [
        ("", [(0, 2.0), (0, math.ulp(0.0)), (500, 1.0), (-1000, 1.0)]),
        (SPEED, [(0, math.nextafter(2.0, INF)), (0, 0.0), (0, -1.0)]),
        (NOT_FINITE, [(0, NAN), (0, INF), (NAN, 1.0)]),
        (OUTSIDE, [(501, 1.0), (-1001, 1.0)]),
    ],
)
def test_move_boundaries(words, moves):
    for target, speed in moves:
        assert is_refused(refuse_move(LIMITS, target, speed), words), (target, speed)


@pytest.mark.parametrize("drive", DriveState)
@pytest.mark.parametrize("mode", [*JointMode, None])
@pytest.mark.parametrize("in_control", [False, True])
def test_commands_require_control_enabled_drive_and_position_mode(in_control, drive, mode):
    words = "does not control the arm" if not in_control else ""
    if in_control and drive is not DriveState.OPERATION_ENABLED:
        words = f"its drive is in state '{drive.value}'"
    elif in_control and mode is not JointMode.POSITION:
        words = f"the drive is in {'no known' if mode is None else 'free'} mode"
    assert is_refused(refuse_command(4, in_control=in_control, drive=drive, mode=mode), words)


@given(st.floats(-1e6, 1e6) | st.sampled_from([NAN, INF, -INF]), st.integers(-1500, 1500))
def test_accepted_target_is_in_range_near_and_finite(target, previous):
    if not refuse_target(LIMITS, target, previous):
        assert math.isfinite(target)
        assert abs(target - previous) <= 20
        assert -1000 <= target <= 500 or abs(target + 250) < abs(previous + 250)


def test_limits_from_radians_are_rounded_inwards():
    scale = JointScale(counts_per_rad=100.0)
    limits = joint_limits(1, scale, (-1.009, 2.001), 3.0)
    assert (limits.lower_counts, limits.upper_counts) == (-100, 200)
    assert limits.max_step_counts == 4  # 3 counts a period, and one for rounding


def test_range_on_whole_counts_is_not_rounded():
    scale = JointScale(counts_per_rad=4000 / (2 * math.pi))
    for counts in range(-4000, 4000, 37):
        lower, upper = (n * (2 * math.pi / 4000) for n in (counts, counts + 10))
        limits = joint_limits(1, scale, (lower, upper), 1.0)
        assert (limits.lower_counts, limits.upper_counts) == (counts, counts + 10)


@given(st.floats(0.001, 3.0), st.floats(-2.0, 2.0), st.floats(600.0, 70000.0))
def test_steps_at_maximum_speed_are_accepted(speed, start, counts_per_rad):
    scale = JointScale(counts_per_rad=counts_per_rad)
    limits = joint_limits(1, scale, (-5, 5), speed)
    targets = [scale.to_counts(start + k * speed * 0.01) for k in range(50)]
    for previous, target in itertools.pairwise(targets):
        assert not refuse_target(limits, target, previous)


@pytest.mark.parametrize(
    "invalid",
    [
        {"lower_counts": 501},
        {"max_speed_rad_per_s": 0.0},
        {"max_speed_rad_per_s": -1.0},
        {"max_speed_rad_per_s": NAN},
        {"max_step_counts": 0},
    ],
)
def test_invalid_limits_raise_value_error(invalid):
    with pytest.raises(ValueError, match="joint 4"):
        replace(LIMITS, **invalid)


def test_single_count_range_is_accepted():
    limits = replace(LIMITS, lower_counts=7, upper_counts=7)
    assert not refuse_move(limits, 7, 1.0)
    assert "is outside 7 .. 7" in refuse_move(limits, 8, 1.0)


@pytest.mark.parametrize("counts_per_rad", [0.0, NAN, INF, -INF])
def test_scale_must_be_finite_and_nonzero(counts_per_rad):
    with pytest.raises(ValueError, match="not zero"):
        JointScale(counts_per_rad=counts_per_rad)


def test_scale_round_trip():
    scale = JointScale(counts_per_rad=8000 / (2 * math.pi))
    assert scale.to_counts(math.pi) == 4000
    assert scale.to_counts(-math.pi / 2) == -2000
    assert scale.to_rad(4000) == pytest.approx(math.pi, abs=1e-15)
    with pytest.raises((ValueError, OverflowError)):
        scale.to_counts(NAN)
