"""The linear mixed model of a loop: its equations and their columns at one linearisation, whitened by the noise.

At one linearisation the reduced closure of all poses reads

    w + A dx + Z b + B n + E' f = 0,     n ~ N(0, S),  f ~ N(0, F),  b_l ~ N(0, g_l I),

w is the misclosure, including expected play and sag. dx are the steps of the parameters without a prior, A their
columns. b are the coefficients of the effects, Z their columns; those of group l have the variance g_l, a function of
variance components (`solver.estimators.layout`). n is the noise of the joints, f that of the fixture. Noise is
independent from pose to pose; an effect has one coefficient for all poses. Effects are deviations of D-H entries and
analogue sensors, harmonics of encoders, and functions of the pose for play, sag and deflection.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from solver.arrays import BoolArray, FloatArray, IntArray, pose_slices, select_poses
from solver.closing import Rates, ReducedEquations, reduced_equations
from solver.estimators.error_model import distance_rows
from solver.estimators.implicit import whitener
from solver.estimators.layout import FIXTURE_NOISE, UNMODELLED, Layout
from solver.estimators.shapes import JointShapes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class System(ReducedEquations):
    """Reduced closure equations of m poses; `w`, `A`, `B` and `E` are those of the module's docstring.

    `angle` (m, n): corrected joint angles, rad, at which sensor errors are evaluated.
    `distances`: misclosures (k,) and derivatives (k, P) of the k measured distances, which do not depend on the poses.
    """

    angle: FloatArray
    distances: tuple[FloatArray, FloatArray] = (np.zeros(0), np.zeros((0, 0)))

    @property
    def noise_columns(self) -> FloatArray:
        """Columns C = [B, E'] (m, r, n + k), along which the noise of n joints, then of k closure components, acts."""
        return np.concatenate((self.B, np.swapaxes(self.E, -1, -2)), axis=-1)

    @property
    def equations(self) -> int:
        """Number of equations: closure equations of all poses, plus one for each distance."""
        return self.w.size + self.distances[0].size

    def at_poses(self, poses: IntArray | slice) -> System:
        """Return the equations of a selection of poses."""
        return select_poses(self, poses, "w", "A", "B", "E", "angle")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Whitened:
    """Whitened equations of m poses, r of them for each pose.

    `M` (m, r, width): columns of the parameters without a prior, then of the effects. `w` (m, r): misclosures.
    `L_inverse` (m, r, r): matrices that whiten the equations.
    `C` (m, r, n + k): whitened `System.noise_columns`, one for each of n joints and k closure components.
    `noise` (m, n + k): variance of the noise that acts along each of these columns.
    """

    poses: slice
    M: FloatArray
    w: FloatArray
    L_inverse: FloatArray
    C: FloatArray
    noise: FloatArray

    def times(self, coefficients: FloatArray) -> FloatArray:
        """Return ``M @ coefficients`` (m, r, ...) for `coefficients` (width, ...)."""
        m, r, width = self.M.shape
        product = self.M.reshape(m * r, width) @ coefficients
        return product.reshape(m, r, *coefficients.shape[1:])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseSources:
    """Noise of m poses, along n joints and k closure components, from each of s sources.

    `names`: the sources. `component` (s,): index of the variance component that scales each source; -1 for none.
    `rates` (s, m, n + k): variance of each source if its component is 1; the variance itself if it has no component.
    `missed` (s,): true for the part of play that the columns of play leave out. The variance component of these columns
    scales this part as well, but by at most 1. The component is estimated from the columns only: a joint rests on the
    same side of its play each time, so this part does not scatter like noise.
    `estimated` (c,): indices of the components that are estimated from the noise.
    `derivatives` (m, n + k, c): derivatives of the noise's variance with respect to the components in `estimated`.
    """

    names: tuple[str, ...]
    component: IntArray
    missed: BoolArray
    rates: FloatArray
    estimated: IntArray
    derivatives: FloatArray

    def variances(self, v: FloatArray) -> FloatArray:
        """Return the noise variance (s, m, n + k) of every source for variance components `v` (K,)."""
        return self.rates * self._factors(v)[:, None, None]

    def total(self, v: FloatArray) -> FloatArray:
        """Return the noise variance (m, n + k) of all sources together for variance components `v` (K,)."""
        s, *shape = self.rates.shape
        return np.asarray((self._factors(v) @ self.rates.reshape(s, -1)).reshape(shape))

    def _factors(self, v: FloatArray) -> FloatArray:
        factor = np.append(v, 1.0)[self.component]
        return np.where(self.missed, np.minimum(factor, 1.0), factor)


class LinearModel(Layout):
    """A `Layout` with methods that calculate its noise and the columns of its effects, for some poses at a time."""

    _noise: tuple[slice, NoiseSources] | None = None

    @cached_property
    def along_joints(self) -> JointShapes:
        """Columns of the effects that change joint angles."""
        return JointShapes(self.q, self.accuracy, self.errors.curves, (self.play, self.sags))

    def at_poses(self, poses: IntArray) -> LinearModel:
        """Return the model of a selection of poses. Smooth functions of the pose are recomputed from these poses."""
        return LinearModel(
            self.model.at_poses(poses),
            self.q[poses],
            self.errors.at_poses(poses),
            group=None if self.group is None else self.group[poses],
        )

    def unsigned(self) -> LinearModel:
        """Return the model in which sag and play are equally likely in either direction."""
        errors = replace(self.errors, signed=False)
        return LinearModel(self.model, self.q, errors, group=self.group, like=self)

    # ---- noise

    def noise_sources(self, poses: slice) -> NoiseSources:
        """Return all noise (errors independent from pose to pose) by source, at a slice of the poses."""
        if self._noise is None or self._noise[0] != poses:
            self._noise = (poses, self._sources_at(poses))
        return self._noise[1]

    def _sources_at(self, poses: slice) -> NoiseSources:
        n, errors = self.model.joint_count, self.errors
        listed: list[tuple[str, int]] = []
        rates: list[FloatArray] = []

        def add(source: str, columns: slice, rate: FloatArray | float, name: str = "") -> None:
            listed.append((source, self.index.get(name, -1)))
            rates.append(np.zeros((len(self.q[poses]), n + self.rows)))
            rates[-1][:, columns] = rate

        joints, closure = slice(0, n), slice(n, None)
        read = ~np.isin(np.arange(1, n + 1), self.model.unsensed_joints)
        for a in errors.analogue:
            reading = slice(a.joint - 1, a.joint)
            add(f"rvdt_noise_{a.joint}", reading, a.share[poses, None], f"rvdt_{a.joint}")
        add("counts", joints, errors.joint_variance[poses] * read)
        if len(self.play.joints):
            add("joint_play", joints, self.play.missed[poses], "play_sides")
            add("joint_play", joints, self.backlash**2, "joint_play")
        if len(self.sags.joints):
            add("sag", joints, self.sags.missed[poses], UNMODELLED)
        if errors.endpoint_variance.any():
            add("instrument", closure, errors.endpoint_variance[6 - self.rows :])
        for rows, stated in self.deflecting_rows:
            rate = self.deflection_basis.missed[poses, None] * self.free_deflection * stated**2
            along_rows = slice(n + rows.start, n + rows.stop)
            add("fixture_give", along_rows, rate, UNMODELLED)
        if self.loaded is not None:
            missed = self.loaded.missed_variance(self.deflection, poses)
            add("fixture_give", closure, missed, UNMODELLED)
        for name, rows in zip(FIXTURE_NOISE, (slice(n, n + 3), slice(-3, None)), strict=True):
            if name in self.index:
                add("fixture_give", rows, 1.0, name)
        names, indices = zip(*listed, strict=True)
        component, every = np.array(indices), np.stack(rates)
        missed = np.append(self.variance_rates.any(axis=0), False)[component]
        own = np.unique(component[(component >= 0) & ~missed])
        by_own = np.tensordot((own[:, None] == component).astype(float), every, 1)
        return NoiseSources(
            names=names,
            component=component,
            missed=missed,
            rates=every,
            estimated=own,
            derivatives=np.ascontiguousarray(np.moveaxis(by_own, 0, -1)),
        )

    def noise_variance(self, v: FloatArray) -> FloatArray:
        """Return the noise variances (m, n + k) of n joints and k closure components, rad^2 or m^2, for `v` (K,)."""
        return np.concatenate([self.noise_sources(poses).total(v) for poses in self.parts()])

    def smooth_deflection_variance(self, v: FloatArray) -> FloatArray:
        """Return the variance (6,), rad^2 then m^2, of the part of the deflection that repeats at the same pose."""
        variance = np.zeros(6)
        # One group for each of `deflecting_rows` with columns (the discrepancy's too), then that of the loads.
        groups = [g for g in self.groups if g.source == "fixture_give"]
        for (rows, _), g in zip(self.deflecting_rows, groups, strict=False):
            variance[6 - self.rows :][rows] += g.variance(v)
        if self.loaded is not None:
            shapes = (self.loaded.modelled_deflection(self.deflection, s) for s in self.parts())
            squares = [(shape**2).sum((0, 2)) for shape in shapes]
            variance[6 - self.rows :] += v[self.index["compliance"]] * sum(squares) / len(self.q)
        return variance

    # ---- columns

    def parts(self) -> list[slice]:
        """Return slices of poses. Whitening one slice at a time keeps the memory for the columns small."""
        return pose_slices(len(self.q))

    def whiten(self, system: System, v: FloatArray, root: FloatArray, poses: slice) -> Whitened:
        """Return the equations `system` of these `poses`, whitened with the noise at variances `v` (K,).

        `root` (f,): standard deviations of the coefficients of the f effects. Each effect's column is multiplied by its
        standard deviation. Raises `PosesDoNotFitError` if poses are far from closing (see `whitener`).
        """
        C, noise = system.noise_columns, self.noise_sources(poses).total(v)
        V = (C * noise[:, None, :]) @ np.swapaxes(C, -1, -2)
        L_inverse = whitener(V)
        C = L_inverse @ C
        Ew = C[..., self.model.joint_count :]
        Aw = L_inverse @ system.A
        m, r = system.w.shape
        M = np.empty((m, r, self.width))
        M[..., : self.flat_count] = Aw[..., self.flat_index]
        effects, at = M[..., self.flat_count :], len(self.prior_index)
        effects[..., :at] = Aw[..., self.prior_index] * (self.prior_sd * root[:at])
        along, shapes = self.along_joints, self.along_joints.at(system.angle, poses)
        end = at + len(along.joint_of)
        shapes = shapes * root[at:end]
        np.multiply(C[..., along.joint_of], shapes[:, None, :], out=effects[..., at:end])
        at = end
        for rows, _ in self.deflecting_rows:
            phi = self.deflection_basis.phi[poses]
            end = at + 3 * phi.shape[1]
            sized = phi[:, None, None, :] * root[at:end].reshape(3, -1)
            columns = effects[..., at:end].reshape(m, r, 3, -1)
            np.multiply(Ew[..., rows, None], sized, out=columns)
            at = end
        if self.loaded is not None:
            by_load = self.loaded.modelled_deflection(self.deflection, poses)
            effects[..., at:] = Ew @ (by_load * root[at:])
        w = (L_inverse @ system.w[..., None])[..., 0]
        return Whitened(poses=poses, M=M, w=w, L_inverse=L_inverse, C=C, noise=noise)

    def effects_at(self, b: FloatArray, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the joint corrections (m, n) and fixture displacements (m, k) caused by effects with coefficients `b`.

        The corrections include expected play and sag. `b` (f,): coefficients of the f effects, see `LinearFit.b`.
        """
        shift, deflection = self.expected.copy(), np.zeros((len(self.q), self.rows))
        at = len(self.prior_index)
        end = at + len(self.along_joints.joint_of)
        for poses in self.parts():
            shift[poses] += self.along_joints.shift(b[at:end], angle[poses], poses)
        at = end
        for rows, _ in self.deflecting_rows:
            k = self.deflection_basis.phi.shape[1]
            deflection[:, rows] = self.deflection_basis.phi @ b[at : at + 3 * k].reshape(3, k).T
            at += 3 * k
        if self.loaded is not None:
            for poses in self.parts():
                by_load = self.loaded.modelled_deflection(self.deflection, poses)
                deflection[poses] += by_load @ b[at:]
        return shift, deflection


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class State:
    """Parameters x (P,), joint corrections e (m, n), unsensed angles u (m, U), and the angles for linearisation.

    Loops are linearised at joint angles `closed_q` (m, n) and unsensed angles `closed_u` (m, U), rad, at which they
    close without deflection of the fixture. If open loops were linearised, the fit would shrink the arm, because the
    gaps of a smaller arm are smaller. This bias is of the order of the noise squared, and for many poses it dominates.
    """

    x: FloatArray
    e: FloatArray
    u: FloatArray
    closed_q: FloatArray
    closed_u: FloatArray


class Linearisation:
    """The equations of the model `design`, linearised at `state`, and computed for some poses at a time to save memory.

    The equations of the last requested slice of poses are kept, so a slice of all poses is computed only once.
    """

    def __init__(self, design: LinearModel, state: State) -> None:
        self.state = state
        self._model, self._q, self._expected = design.model, design.q, design.expected
        # The unknowns are deviations from nominal for parameters with a prior, and steps from `state` for the others.
        self._deviation = state.x - design.nominal
        self._deviation[design.flat_index] = 0.0
        w, rates = distance_rows(design.errors.distances, design.model.parameters, state.x)
        self.distances = (w - rates @ self._deviation, rates)
        self.equations = len(design.q) * design.model.equations_per_pose + len(w)
        self._last: tuple[slice, System, Rates] | None = None

    def at_poses(self, poses: IntArray | slice) -> System:
        """Return the equations of a selection of poses."""
        return self._of(poses)[0] if isinstance(poses, slice) else self._made(poses)[0]

    def rates(self, poses: slice) -> Rates:
        """Return the coefficients that give the step of the unsensed angles, for a slice of the poses."""
        return self._of(poses)[1]

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
        reduced = reduced_equations(error)
        w = reduced.w - reduced.A @ self._deviation
        w += (reduced.B @ (self._expected[poses] - e)[..., None])[..., 0]
        system = System(
            w=w, A=reduced.A, B=reduced.B, E=reduced.E, angle=angle, distances=self.distances
        )
        return system, Rates.of(error, e)
