"""Paths of the drive joints from pose to pose along the manifold, with changes of drive joints on the way.

The graph has one layer for each drive set, with all poses of the manifold. A layer joins two neighbouring poses if its
drives can move the chain between them: they have leverage at both poses and cross no singularity. A route is accepted
only if the exact prediction of all its moves is safe. Otherwise the edge that fails is removed from the graph.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, groupby
from typing import TYPE_CHECKING

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.design.manifold import Manifold
from solver.design.motion import MotionLimits, Ranges, drive_straight

if TYPE_CHECKING:
    from scipy.sparse import csr_array

AT_START = 0.6
"""Share of the lower limit of leverage that is enough at the present pose, so that the arm can leave this pose."""
BETWEEN = 0.8
"""Share of the lower limit of leverage that is enough on a straight line between two poses that keep the limit."""
CHANGE_COST_RAD = 0.5
"""Cost of a change of drive joints (stopping, switching and settling), as the motion (rad) that costs the same."""
ATTEMPTS = 20
"""Number of paths that are tried; another is searched after an edge has failed."""
LINE_STEP_RAD = 0.03
"""Largest step of any drive joint in the prediction of a straight move."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Leg:
    """Straight moves of one set of drive joints, one after the other.

    `drives`: joints (1-based) in position mode; all others are free. `waypoints_rad` (k, n): angles of all joints at
    the end of each move, of which only the drives' are commanded. `trace_rad` (t, n): predicted angles of all joints
    from the start to the end of the leg, closely spaced.
    """

    drives: tuple[int, ...]
    waypoints_rad: FloatArray
    trace_rad: FloatArray


class PathGraph:
    """Graph of paths between poses; a node is a pose with a drive set, and edges are moves or changes of drive set.

    `manifold`: poses and their neighbours. `drive_sets`: usable sets of drive joints; the number of joints in a set is
    the chain's mobility. `limits`: limits of every path. `allowed` (m,): poses that a path may pass; all by default.
    """

    def __init__(
        self,
        manifold: Manifold,
        drive_sets: Sequence[tuple[int, ...]],
        limits: MotionLimits,
        *,
        allowed: BoolArray | None = None,
    ) -> None:
        self.manifold = manifold
        self.drive_sets = tuple(drive_sets)
        self.limits = limits
        self._allowed = np.ones(manifold.size, dtype=np.bool_) if allowed is None else allowed
        # Least leverage and largest rate for every pose; pose 0 is the arm's present pose.
        self._least = np.full(manifold.size, limits.least_leverage)
        self._most = np.full(manifold.size, limits.most_rate)
        self._least[0] *= AT_START
        self._most[0] /= AT_START
        self._leverage = np.array([manifold.motion.leverage(drives) for drives in self.drive_sets])
        self._open = [self._passable(layer) for layer in range(len(self.drive_sets))]
        # The cost of an edge is its length, increased where the drives have little leverage.
        i, j = manifold.neighbours.T
        least = np.maximum(np.minimum(self._leverage[:, i], self._leverage[:, j]), 1e-3)
        length = np.linalg.norm(manifold.q[i] - manifold.q[j], axis=-1)
        self._cost = length * (1.0 + (limits.least_leverage / least) ** 2)
        self._graph = self._assemble()

    def reachable(self, source: int) -> BoolArray:
        """Whether each pose (m,) can be reached from `source`, with changes of drive set on the way."""
        from scipy.sparse.csgraph import connected_components

        _, label = connected_components(self._graph, directed=False)
        layers = label.reshape(len(self.drive_sets), self.manifold.size)
        return np.asarray((layers == label[source]).any(axis=0))

    def distances(self, sources: Sequence[int]) -> FloatArray:
        """Return the costs (k, k) of the cheapest paths between the k poses `sources`; inf if there is no path."""
        from scipy.sparse.csgraph import dijkstra

        size, layers, count = self.manifold.size, len(self.drive_sets), len(sources)
        nodes = np.concatenate([np.asarray(sources) + k * size for k in range(layers)])
        between = dijkstra(self._graph, directed=False, indices=nodes)[:, nodes]
        # A path may start with any drives; the graph adds the cost of a change where the path needs one.
        return np.asarray(between.reshape(layers, count, layers, count).min(axis=(0, 2)))

    def route(
        self, ranges: Ranges, *, source: int, target: int, drives: tuple[int, ...]
    ) -> tuple[Leg, ...] | None:
        """Find a path, check along its whole length that it is safe inside `ranges`, and return its legs.

        The result is None if no path passes the check. `drives`: drive joints at pose `source`.
        """
        for _ in range(ATTEMPTS):
            if (nodes := self._search(source, target, drives)) is None:
                return None
            if (legs := self._follow(ranges, nodes)) is not None:
                return legs
            self._graph = self._assemble()
        return None

    def _passable(self, layer: int) -> BoolArray:
        """Whether the drive set of a layer can move the chain along each edge (E,)."""
        i, j = self.manifold.neighbours.T
        motion, drives = self.manifold.motion, self.drive_sets[layer]
        volume = np.linalg.det(motion.tangent[:, [j - 1 for j in drives]])
        # With no singularity between two poses, transport of the tangent keeps the sign of the drives' determinant.
        carried = np.linalg.det(np.swapaxes(motion.tangent[i], -1, -2) @ motion.tangent[j])
        usable = self._allowed & (self._leverage[layer] >= self._least)
        usable &= np.linalg.norm(motion.rates(drives), axis=-1).max(-1) <= self._most
        return np.asarray(usable[i] & usable[j] & (volume[i] * volume[j] * carried > 0.0))

    def _assemble(self) -> csr_array:
        from scipy.sparse import csr_array

        size, layers = self.manifold.size, len(self.drive_sets)
        i, j = self.manifold.neighbours.T
        edges = [
            (i[open_] + k * size, j[open_] + k * size, cost[open_])
            for k, (open_, cost) in enumerate(zip(self._open, self._cost, strict=True))
        ]
        usable = self._allowed & (self._leverage >= self._least)
        for a, b in combinations(range(layers), 2):
            both = np.flatnonzero(usable[a] & usable[b])
            change = np.full(len(both), CHANGE_COST_RAD)
            edges.append((both + a * size, both + b * size, change))
        rows, columns, values = map(np.concatenate, zip(*edges, strict=True))
        return csr_array((values, (rows, columns)), shape=(layers * size, layers * size))

    def _search(
        self, source: int, target: int, drives: tuple[int, ...]
    ) -> list[tuple[int, int]] | None:
        """Return the cheapest path as pairs (index of the drive set, index of the pose); None if there is no path."""
        from scipy.sparse.csgraph import dijkstra

        size = self.manifold.size
        start = self.drive_sets.index(drives) * size + source
        costs, predecessors = dijkstra(
            self._graph, directed=False, indices=[start], return_predecessors=True
        )
        cost, before = costs[0], predecessors[0]
        ends = [k * size + target for k in range(len(self.drive_sets))]
        end = min(ends, key=lambda node: float(cost[node]))
        if not np.isfinite(cost[end]):
            return None
        nodes = [end]
        while nodes[-1] != start:
            nodes.append(int(before[nodes[-1]]))
        return [divmod(node, size) for node in reversed(nodes)]

    def _follow(self, ranges: Ranges, nodes: list[tuple[int, int]]) -> tuple[Leg, ...] | None:
        """Return safe straight moves along the path `nodes`; None if `_leg` finds no safe move and removes an edge."""
        legs = []
        for layer, group in groupby(nodes, key=lambda node: node[0]):
            poses = [pose for _, pose in group]
            if len(poses) > 1:
                if (leg := self._leg(ranges, layer, poses)) is None:
                    return None
                legs.append(leg)
        return tuple(legs)

    def _leg(self, ranges: Ranges, layer: int, poses: list[int]) -> Leg | None:
        """Return long safe straight moves along `poses`; where none is safe, remove the next edge and return None."""
        drives = self.drive_sets[layer]
        columns = [j - 1 for j in drives]
        q, u = self.manifold.q[poses], self.manifold.u[poses]
        waypoints, trace = [], [q[:1]]
        position = 0
        while position < len(poses) - 1:
            ahead = np.arange(position + 1, len(poses))
            targets = q[ahead][:, columns]
            longest = float(np.abs(targets - q[position, columns]).max())
            lines = drive_straight(
                self.manifold.model,
                self.manifold.x,
                np.repeat(q[position : position + 1], len(ahead), axis=0),
                np.repeat(u[position : position + 1], len(ahead), axis=0),
                drives,
                targets,
                steps=max(2, int(np.ceil(longest / LINE_STEP_RAD))),
            )
            share = AT_START if poses[position] == 0 else BETWEEN
            safe = lines.safe(ranges, self.limits.eased(share))
            # The same drive angles on another branch are another pose.
            safe &= np.abs(lines.q[:, -1] - q[ahead]).max(-1) < 1e-6
            if not safe.any():
                edge = sorted(poses[position : position + 2])
                self._open[layer] &= (self.manifold.neighbours != edge).any(axis=1)
                return None
            best = int(np.flatnonzero(safe)[-1])
            waypoints.append(q[ahead[best]])
            trace.append(lines.q[best, 1:])
            position = int(ahead[best])
        return Leg(
            drives=drives, waypoints_rad=np.stack(waypoints), trace_rad=np.concatenate(trace)
        )
