import itertools

import numpy as np
import pytest

from solver.design.motion import LIMITS, MotionLimits, drive_straight
from solver.design.paths import PathGraph
from solver.design.plan import visiting_order
from tests.oracles.loop_oracle import closure, paper_truth

TRUTH = paper_truth()


@pytest.fixture(scope="module")
def graph(region):
    return PathGraph(region, [(1, 5), (3, 5)], LIMITS)


@pytest.fixture(scope="module")
def reached_by_first_pair(region):
    """Poses that joints 1 and 5 reach without a change of drives."""
    return PathGraph(region, [(1, 5)], LIMITS).reachable(0)


def far_poses(reached_by_first_pair: np.ndarray, count: int) -> list[int]:
    reached = np.flatnonzero(reached_by_first_pair)
    return [int(k) for k in np.random.default_rng(0).choice(reached, count, replace=False)]


def test_routes_arrive_in_range_with_closed_loops(graph, reached_by_first_pair, loop, x, ranges):
    position, drives = 0, (1, 5)
    for target in far_poses(reached_by_first_pair, 12):
        route = graph.route(ranges, source=position, target=target, drives=drives)
        assert route is not None
        assert route[-1].waypoints_rad[-1] == pytest.approx(graph.manifold.q[target], abs=1e-6)
        for leg in route:
            assert ranges.clearance(leg.trace_rad).min() >= 0.0
            u = loop.initial_unsensed(x, leg.trace_rad)
            angles = np.concatenate((u[:, :1], leg.trace_rad), axis=1)
            assert np.abs(closure(TRUTH, angles)).max() < 1e-7
            assert np.abs(np.diff(leg.trace_rad, axis=0)).max() < 0.3
        position, drives = target, route[-1].drives


def test_drives_move_in_straight_lines(graph, reached_by_first_pair, ranges):
    (target,) = far_poses(reached_by_first_pair, 1)
    leg = graph.route(ranges, source=0, target=target, drives=(1, 5))[0]
    drives = leg.trace_rad[:, [j - 1 for j in leg.drives]]
    corners = np.concatenate((drives[:1], leg.waypoints_rad[:, [j - 1 for j in leg.drives]]))
    for point in drives:
        distance = min(
            np.linalg.norm(
                point - (a + np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1) * (b - a))
            )
            for a, b in itertools.pairwise(corners)
        )
        assert distance < 1e-9


def test_route_changes_drives_where_necessary(graph, reached_by_first_pair, ranges):
    only_both = np.flatnonzero(graph.reachable(0) & ~reached_by_first_pair)
    route = graph.route(ranges, source=0, target=int(only_both[0]), drives=(1, 5))
    assert route is not None
    assert {leg.drives for leg in route} >= {(3, 5)}


def test_no_route_leaves_an_isolated_pose(region, ranges):
    allowed = np.zeros(region.size, dtype=bool)
    allowed[[0, region.size - 1]] = True
    graph = PathGraph(region, [(1, 5)], LIMITS, allowed=allowed)
    assert graph.reachable(0).sum() == 1
    assert graph.route(ranges, source=0, target=region.size - 1, drives=(1, 5)) is None


@pytest.mark.campaign
def test_line_into_a_singularity_is_not_safe(loop, x, region, ranges):
    # Driving joints 6 and 7 outwards from their best pose, away from the ends of the ranges, ends in a singularity.
    room = ranges.clearance(region.q) > 0.1
    start = int(np.argmax(np.where(room, region.motion.leverage((6, 7)), 0.0)))
    q, u = region.q[start : start + 1], region.u[start : start + 1]
    safe = []
    for angle in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False):
        target = q[:, 5:7] + 1.2 * np.array([[np.cos(angle), np.sin(angle)]])
        lines = drive_straight(loop, x, q, u, (6, 7), target, steps=60)
        safe.append(bool(lines.safe(ranges, MotionLimits(least_leverage=0.2, most_rate=6.0))[0]))
    assert not all(safe)
    still = drive_straight(loop, x, q, u, (6, 7), q[:, 5:7] + 0.02, steps=3)
    assert still.safe(ranges, MotionLimits(least_leverage=0.05, most_rate=20.0))[0]


def test_visiting_order_is_near_the_shortest():
    points = np.random.default_rng(5).uniform(size=(9, 2))
    distances = np.linalg.norm(points[:, None] - points[None], axis=-1)

    def length(order) -> float:
        return sum(distances[a, b] for a, b in itertools.pairwise([0, *order]))

    best = min(length(p) for p in itertools.permutations(range(1, 9)))
    order = visiting_order(distances)
    assert sorted(order) == list(range(1, 9))
    assert length(order) <= 1.15 * best


def test_visiting_order_with_unreachable_points():
    points = np.random.default_rng(6).uniform(size=(12, 2))
    distances = np.linalg.norm(points[:, None] - points[None], axis=-1)
    distances[3:7] = distances[:, 3:7] = np.inf
    assert sorted(visiting_order(distances)) == list(range(1, 12))


def test_distances_include_poses_of_another_drive_pair(graph, reached_by_first_pair):
    only_both = np.flatnonzero(graph.reachable(0) & ~reached_by_first_pair)[:5]
    points = [0, *far_poses(reached_by_first_pair, 3), *(int(k) for k in only_both)]
    distances = graph.distances(points)
    assert np.isfinite(distances).all()
    assert distances == pytest.approx(distances.T)
