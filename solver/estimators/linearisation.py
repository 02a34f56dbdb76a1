"""The loops of all poses linearised at one state, computed for some poses at a time.

The Jacobians of a hundred thousand poses are never in memory together: those of the requested poses are computed at
each request. The last result is kept, which is everything where poses are few. Knows a closure model and its poses; no
variance and no effect.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.closing import Rates, left_null_space
from solver.estimators.effects import LinearModel, System
from solver.estimators.error_model import distance_rows


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """Parameters x (P,), joint corrections e (m, n), unsensed angles u (m, U), and where loops are linearised.

    They are linearised where they close, with the fixture's deflection attributed to the joints: `closed_q` (m, n) and
    `closed_u` (m, U). A loop left open by the deflection would close better with a smaller arm: the estimated scale
    would have a bias of the order of the noise squared, which dominates with many poses.
    """

    x: FloatArray
    e: FloatArray
    u: FloatArray
    closed_q: FloatArray
    closed_u: FloatArray


class Linearisation:
    """Equations of `design` at `state`; see the module."""

    def __init__(self, design: LinearModel, state: State) -> None:
        self.state = state
        self._model, self._q, self._expected = design.model, design.q, design.expected
        # Effects count from the nominal values of toleranced entries, steps of the others from the present state.
        self._soft = state.x - design.nominal
        self._soft[design.hard_index] = 0.0
        w, rates = distance_rows(design.errors.distances, design.model.parameters, state.x)
        self.distances = (w - rates @ self._soft, rates)
        self.equations = len(design.q) * design.model.equations_per_pose + len(w)
        self._last: tuple[slice, System, Rates] | None = None

    def part(self, poses: slice) -> System:
        """Equations of a slice of the poses."""
        return self._of(poses)[0]

    def rates(self, poses: slice) -> Rates:
        """Rates of the unsensed angles at a slice of the poses."""
        return self._of(poses)[1]

    def at_poses(self, poses: IntArray) -> System:
        """Equations of a selection of poses."""
        return self._made(poses)[0]

    def _of(self, poses: slice) -> tuple[System, Rates]:
        if self._last is None or self._last[0] != poses:
            self._last = (poses, *self._made(np.arange(len(self._q))[poses]))
        return self._last[1:]

    def _made(self, poses: IntArray) -> tuple[System, Rates]:
        state, m = self.state, len(self._q)
        everything = len(poses) == m and bool((poses == np.arange(m)).all())
        model = self._model if everything else self._model.at_poses(poses)
        angle = state.closed_q[poses]
        e = angle - self._q[poses]
        error = model.loop(state.x, angle, state.closed_u[poses])
        E = left_null_space(error.jac_u)
        Et = np.swapaxes(E, -1, -2)
        A = Et @ error.jac_x
        c = error.residual - (error.jac_q @ e[..., None])[..., 0]
        B = Et @ error.jac_q
        w = (Et @ c[..., None])[..., 0] - A @ self._soft
        w += (B @ self._expected[poses, :, None])[..., 0]
        system = System(w=w, A=A, B=B, E=E, angle=angle, distances=self.distances)
        return system, Rates.of(error, c)
