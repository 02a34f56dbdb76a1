"""The one linear mixed model of a loop: its columns at one linearisation, in units of its noise.

At one linearisation the reduced closure of all poses reads

    w + A dx + Z b + B n + E' f = 0,     n ~ N(0, S),  f ~ N(0, F),  b_l ~ N(0, g_l I),

with dx the parameters without a prior, and w after the expected play and sag.
Noise (n, f) is new in every pose, effects b are drawn once: deviations of toleranced entries, harmonics
of encoders, curves of analogue sensors, sag and compliance as smooth functions of the pose. A variance component scales
one or more groups; the stated size is the median of its prior (`solver.estimators.layout` has both).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.closing import Rates, left_null_space
from solver.estimators.error_model import ErrorModel, distance_rows
from solver.estimators.joint_shapes import JointShapes
from solver.estimators.layout import Layout
from solver.loops.closure import ClosureModel

CHUNK = 1024
"""Poses whitened at a time, so that memory does not grow with columns times poses."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class System:
    """Reduced closure equations of m poses (see the module): w (m, r), A (m, r, P), B (m, r, n), E (m, k, r).

    `angle` (m, n) are the corrected joint angles at which curves are evaluated. `distances` are misclosures (k,) and
    derivatives (k, P) of measured distances, which belong to no pose.
    """

    w: FloatArray
    A: FloatArray
    B: FloatArray
    E: FloatArray
    angle: FloatArray
    distances: tuple[FloatArray, FloatArray] = (np.zeros(0), np.zeros((0, 0)))

    @property
    def equations(self) -> int:
        """Number of equations of all poses, and of distances."""
        return self.w.size + self.distances[0].size

    def part(self, poses: slice) -> System:
        """Return the equations of a slice of the poses."""
        return self.at_poses(poses)

    def at_poses(self, poses: IntArray | slice) -> System:
        """Return the equations of a selection of poses."""
        return System(
            w=self.w[poses],
            A=self.A[poses],
            B=self.B[poses],
            E=self.E[poses],
            angle=self.angle[poses],
            distances=self.distances,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Whitened:
    """Whitened columns [hard, effects] and misclosure of some poses.

    `L_inverse` (m, r, r) whitens; `Bw` (m, r, n) and `Ew` (m, r, k) are the joints' and the
    fixture's columns, `S` (m, n) and `F` (m, k) the variances of their noise.
    """

    poses: slice
    M: FloatArray
    w: FloatArray
    L_inverse: FloatArray
    Bw: FloatArray
    Ew: FloatArray
    S: FloatArray
    F: FloatArray

    def times(self, coefficients: FloatArray) -> FloatArray:
        """Columns times coefficients (width, ...): (m, r, ...), as one product for all poses."""
        m, r, width = self.M.shape
        found = self.M.reshape(m * r, width) @ coefficients
        return found.reshape(m, r, *coefficients.shape[1:])


class LinearModel(Layout):
    """Noise and columns of a closure model with stated errors, for parts of the poses.

    `along_joints`: shapes of the effects that act along a joint.
    """

    def __init__(
        self,
        model: ClosureModel,
        q: FloatArray,
        errors: ErrorModel,
        *,
        group: IntArray | None = None,
        like: Layout | None = None,
    ) -> None:
        super().__init__(model, q, errors, group=group, like=like)
        self.along_joints = JointShapes(self)
        nothing = np.zeros((len(q), self.rows))
        self._stated_joints: FloatArray = np.sum([*self.fixed_joint_noise().values()], axis=0)
        self._stated_fixture: FloatArray = sum(self.fixed_fixture_noise().values(), nothing)

    def at_poses(self, poses: IntArray) -> LinearModel:
        """Return the design of a selection of poses; smooth functions are fitted to these only."""
        return LinearModel(
            self.model.at_poses(poses),
            self.q[poses],
            self.errors.at_poses(poses),
            group=None if self.group is None else self.group[poses],
        )

    def unsigned(self) -> LinearModel:
        """Return the design in which sag and play are equally likely to either side."""
        errors = replace(self.errors, signed=False)
        return LinearModel(self.model, self.q, errors, group=self.group, like=self)

    # ---- noise

    def joint_variance(self, v: FloatArray, poses: slice = slice(None)) -> FloatArray:
        """Variance of every joint's noise (m, n), rad^2, under the components (K,)."""
        S = self._stated_joints[poses].copy()
        for k, a in enumerate(self.errors.analogue):
            S[:, a.joint - 1] += v[k] * a.share[poses]
        if self.play_component is not None:
            S += v[self.play_component] * self.backlash**2
        return S

    def fixed_joint_noise(self) -> dict[str, FloatArray]:
        """Variances (m, n), rad^2, of the joints' noise that no component scales, by source."""
        used = np.ones(self.model.joint_count)
        used[[j - 1 for j in self.model.unsensed_joints]] = 0.0
        found = {"counts": self.errors.joint_variance * used}
        if len(self.play_joints):
            found["joint_play"] = self.play.missed * self.backlash**2
        if len(self.sag_joints):
            found["sag"] = self.sags.missed * self.sag**2
        return {s: np.broadcast_to(variance, self.q.shape) for s, variance in found.items()}

    def fixture_variance(self, v: FloatArray, poses: slice = slice(None)) -> FloatArray:
        """Variance of the fixture's noise along the closure components (m, k)."""
        F = self._stated_fixture[poses].copy()
        for key, c in self.fixture_components.items():
            F[:, self._rows_of(key)] += v[c]
        return F

    def _rows_of(self, component: str) -> slice:
        """Closure components along which a component of the fixture's noise acts."""
        return slice(0, 3) if component == "fixture_rad" else slice(self.rows - 3, self.rows)

    def fixed_fixture_noise(self) -> dict[str, FloatArray]:
        """Variances (m, k) of the noise along the closure components that no component scales, by source."""
        measured = np.tile(self.errors.endpoint_variance[6 - self.rows :], (len(self.q), 1))
        gives = np.zeros_like(measured)
        for rows, stated in self.gives:
            gives[:, rows] += (self.give_basis.missed * self.free_give * stated**2)[:, None]
        if self.loaded is not None:
            gives += self.loaded.missed(slice(None))
        return {s: F for s, F in (("instrument", measured), ("fixture_give", gives)) if F.any()}

    def smooth_give_variance(self, v: FloatArray) -> FloatArray:
        """Variance (6,) of the deflection that repeats at the same pose."""
        found = np.zeros(6)
        # One group for each of `gives` with columns (the discrepancy's too), then that of the loads.
        groups = [g for g in self.groups if g.source == "fixture_give"]
        for (rows, _), g in zip(self.gives, groups, strict=False):
            found[6 - self.rows :][rows] += g.variance(v)
        if self.loaded is not None:
            squares = [(self.loaded.columns(here) ** 2).sum((0, 2)) for here in self.parts()]
            found[6 - self.rows :] += sum(squares) / len(self.q)
        return found

    def noise_factors(self, part: Whitened) -> tuple[FloatArray, IntArray]:
        """Columns Q (m, r, f) of the whitened noise, and the component (f,) that scales each.

        A component's derivative of the noise is ``Q Q'`` of its columns.
        """
        factors, component = [np.zeros((*part.w.shape, 0))], list[int]()
        for k, a in enumerate(self.errors.analogue):
            share = np.sqrt(a.share[part.poses])
            factors.append(part.Bw[..., a.joint - 1, None] * share[:, None, None])
            component.append(k)
        for key, c in self.fixture_components.items():
            factors.append(part.Ew[..., self._rows_of(key)])
            component += [c] * 3
        if self.play_component is not None:
            factors.append(part.Bw * self.backlash)
            component += [self.play_component] * len(self.backlash)
        return np.concatenate(factors, axis=-1), np.array(component, dtype=np.int64)

    # ---- columns
    def parts(self) -> Iterator[slice]:
        """Whitened poses, in chunks."""
        for first in range(0, len(self.q), CHUNK):
            yield slice(first, min(first + CHUNK, len(self.q)))

    def whiten(self, system: System, v: FloatArray, root: FloatArray, poses: slice) -> Whitened:
        """Whiten the columns of the poses of `system`.

        `root` (width - hard,) scales the effects: with the root of `group_variances` they have unit variance.
        """
        B, E = system.B, system.E
        Et = np.swapaxes(E, -1, -2)
        S, F = self.joint_variance(v, poses), self.fixture_variance(v, poses)
        V = (B * S[:, None, :]) @ np.swapaxes(B, -1, -2) + (Et * F[:, None, :]) @ E
        L_inverse = np.linalg.inv(np.linalg.cholesky(V))
        Bw, Ew = L_inverse @ B, L_inverse @ Et
        Aw = L_inverse @ system.A
        m, r = system.w.shape
        M = np.empty((m, r, self.width))
        M[..., : self.hard] = Aw[..., self.hard_index]
        effects, at = M[..., self.hard :], len(self.soft_index)
        effects[..., :at] = Aw[..., self.soft_index] * (self.soft_sd * root[:at])
        along, shapes = self.along_joints, self.along_joints.at(system.angle, poses)
        end = at + len(along.joint_of)
        shapes = shapes * root[at:end]
        np.multiply(Bw[..., along.joint_of], shapes[:, None, :], out=effects[..., at:end])
        at = end
        for rows, _ in self.gives:
            phi = self.give_basis.phi[poses]
            end = at + 3 * phi.shape[1]
            sized = phi[:, None, None, :] * root[at:end].reshape(3, -1)
            columns = effects[..., at:end].reshape(m, r, 3, -1)
            np.multiply(Ew[..., rows, None], sized, out=columns)
            at = end
        if self.loaded is not None:
            effects[..., at:] = Ew @ (self.loaded.columns(poses) * root[at:])
        w = (L_inverse @ system.w[..., None])[..., 0]
        return Whitened(poses=poses, M=M, w=w, L_inverse=L_inverse, Bw=Bw, Ew=Ew, S=S, F=F)

    def effects_at(self, b: FloatArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Joint corrections (m, n) and fixture displacement (m, k) of effect coefficients (unscaled).

        Corrections include the expected play and sag.
        """
        shift, give = self.expected.copy(), np.zeros((len(self.q), self.rows))
        at = len(self.soft_index)
        end = at + len(self.along_joints.joint_of)
        for here in self.parts():
            shift[here] += self.along_joints.shift(b[at:end], angle[here], here)
        at = end
        for rows, _ in self.gives:
            k = self.give_basis.phi.shape[1]
            give[:, rows] = self.give_basis.phi @ b[at : at + 3 * k].reshape(3, k).T
            at += 3 * k
        if self.loaded is not None:
            for here in self.parts():
                give[here] += self.loaded.columns(here) @ b[at:]
        return shift, give


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
    """Equations of `design` at `state`, computed for the requested poses at each request.

    The Jacobians of a hundred thousand poses are never in memory together. The last result is kept, which covers all
    poses if there are few.
    """

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
