import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.arm import FloatArray
from hardware.control.trajectory import ACCELERATION_RAD_PER_S2, StraightMove, coming_to_rest_s

PERIOD_S = 0.01
SMOOTHING = 10


def _run(start: list[float], end: list[float], speed: float, brake_at: int = -1) -> FloatArray:
    move = StraightMove(np.array(start), np.array(end), speed_rad_per_s=speed)
    targets = [np.array(start)]
    while not move.finished:
        if len(targets) - 1 == brake_at:
            move.brake()
        targets.append(move.next())
        assert len(targets) < 100_000, "the move never ends"
    return np.array(targets)


angles = st.floats(-3.0, 3.0, allow_nan=False)


@given(
    st.lists(st.tuples(angles, angles), min_size=1, max_size=7),
    st.floats(0.05, 2.0),
    st.integers(-1, 400),
)
@settings(max_examples=150, deadline=None, database=None)
def test_speed_acceleration_and_jerk_stay_within_bounds(ends, speed, brake_at):
    start, end = [a for a, _ in ends], [b for _, b in ends]
    targets = _run(start, end, speed, brake_at)
    steps = np.diff(targets, axis=0) / PERIOD_S
    assert np.abs(steps).max(initial=0.0) <= speed * (1 + 1e-9) + 1e-9
    changes = np.diff(steps, axis=0, prepend=np.zeros((1, len(start)))) / PERIOD_S
    assert np.abs(changes).max(initial=0.0) <= ACCELERATION_RAD_PER_S2 * (1 + 1e-6) + 1e-6
    jerk = np.diff(changes, axis=0, prepend=np.zeros((1, len(start)))) / PERIOD_S
    bound = 2.0 * ACCELERATION_RAD_PER_S2 / (SMOOTHING * PERIOD_S)
    assert np.abs(jerk).max(initial=0.0) <= bound * (1 + 1e-4) + 1e-3
    low, high = np.minimum(start, end), np.maximum(start, end)
    assert np.all(targets >= low - 1e-12)
    assert np.all(targets <= high + 1e-12)


@pytest.mark.parametrize("stands_at", [1, 40, 250])
@pytest.mark.parametrize("brakes", [False, True])
def test_move_that_stood_still_starts_again_from_rest(stands_at, brakes):
    move = StraightMove(np.zeros(2), np.array([1.0, -0.5]), speed_rad_per_s=0.35)
    for _ in range(stands_at):
        stood = move.next()
    move.start_from_rest()
    if brakes:
        move.brake()
        assert np.array_equal(move.next(), stood)
        assert move.finished
        return
    rest = _run(stood.tolist(), [1.0, -0.5], 0.35)
    assert np.array_equal([move.next() for _ in rest[1:]], rest[1:])
    assert move.finished


def test_braking_move_does_not_start_again():
    one, other = (StraightMove(np.zeros(1), np.ones(1), speed_rad_per_s=0.5) for _ in range(2))
    for move in (one, other):
        for _ in range(100):
            move.next()
        move.brake()
    one.start_from_rest()
    assert np.array_equal([one.next() for _ in range(80)], [other.next() for _ in range(80)])
    assert one.finished


@given(st.lists(st.tuples(angles, angles), min_size=1, max_size=7))
@settings(max_examples=50, deadline=None, database=None)
def test_path_is_straight_and_ends_at_target(ends):
    start, end = np.array([a for a, _ in ends]), np.array([b for _, b in ends])
    targets = _run(start.tolist(), end.tolist(), 0.5)
    assert np.abs(targets[-1] - end).max() <= 4e-16 * 3.0
    displacement = end - start
    if np.abs(displacement).max() > 1e-3:
        fraction = (targets - start) @ displacement / (displacement @ displacement)
        assert np.abs(targets - (start + fraction[:, None] * displacement)).max() < 1e-12
        assert np.all(np.diff(fraction) >= -1e-15)


def test_duration_equals_trapezoid_plus_smoothing():
    targets = _run([0.0, 0.0], [1.0, -0.5], 0.5)
    # 0.5 s up, 0.5 s down cover 0.25 rad; 0.75 rad at 0.5 rad/s take 1.5 s; the mean adds 9 periods.
    assert len(targets) - 1 == pytest.approx(2.5 / PERIOD_S + SMOOTHING - 1, abs=1)


def test_moves_without_distance_or_speed():
    assert np.ptp(_run([0.3], [2.0], 0.5, brake_at=0)) == 0.0
    assert len(_run([1.0, 2.0], [1.0, 2.0], 0.5)) == 1


@pytest.mark.parametrize("speed", [0.05, 0.35, 1.0])
def test_braking_distance_matches_prediction(speed):
    move = StraightMove(np.zeros(1), np.array([4.0]), speed_rad_per_s=speed)
    position = previous = 0.0
    while position < 1.5:
        previous, position = position, float(move.next()[0])
    current_speed = (position - previous) / PERIOD_S
    move.next()  # braking begins two periods after the position was read
    final = float(move.next()[0])
    move.brake()
    periods = 0
    while not move.finished:
        final, periods = float(move.next()[0]), periods + 1
    assert periods <= speed / 1.0 / PERIOD_S + SMOOTHING + 1
    assert final - position == pytest.approx(current_speed * coming_to_rest_s(speed), rel=0.02)
