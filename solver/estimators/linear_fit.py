"""A linear mixed model solved for given variances, and the results of one linearisation.

Henderson's mixed-model equations are solved in whitened coordinates. The columns M are those of the parameters without
a prior, then those of the effects, scaled to unit variance. The matrix of the equations is
``H = M'M + diag(0, I)``. No array grows with the square of the number of poses. The results are the covariance, the
repeatability, the uncertainty budget, the misfit of poses to their prediction from others, and scores of new columns.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from itertools import chain

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.estimators.effects import Linearisation, LinearModel, System, Whitened
from solver.estimators.scoring import Derivatives, likelihood_derivatives

np.empty(2 << 20)
"""This array is allocated and freed once: from then on glibc keeps free blocks up to this size, instead of returning
the matrices of every iteration to the system and having them zeroed again. Other C libraries are not affected."""

LEAST_PULL_INFORMATION = 1e-6
"""A pull (see `pulls`) counts only if the poses determine at least this share of the effect's prior variance."""

FREE = 1e-9
"""Along an eigenvector of ``I - N N'`` (`_held_out`) with a smaller eigenvalue, the other poses predict nothing."""


class LinearFit:
    """The mixed model of `design` at one linearisation, solved for given variance components `v` (K,).

    `change` (P,): fitted change of each parameter, rad or m: from its nominal value if it has a prior, otherwise from
    its value at the linearisation.
    `unit` (P,): change of each parameter, rad or m, if the coefficient of the parameter's column is 1.
    `b` (f,): predicted coefficient of each of f effects, not scaled to unit variance.
    `half` (width, width): upper triangular root of the inverse, ``H^-1 = half half'``.
    `chi2`: ``w' P w``, with the whitened misclosure w and the projector ``P = I - M H^-1 M'``.
    `dof`: number of equations minus number of parameters without a prior; the expectation of `chi2` if `v` is right.
    """

    def __init__(self, design: LinearModel, system: System | Linearisation, v: FloatArray) -> None:
        self.design, self.system, self.v = design, system, np.array(v, dtype=np.float64)
        flat, known = design.flat_count, len(design.prior_index)
        self.root = np.sqrt(design.group_variances(self.v))
        self.unit = np.ones(flat + known)
        self.unit[design.prior_index] = design.prior_sd * self.root[:known]
        slices = design.parts()
        self._whitened: list[Whitened] = []
        self.H = np.zeros((design.width, design.width))
        right = np.zeros(design.width)
        square, logdet = 0.0, 0.0
        for poses in slices:
            part = self._whiten(poses)
            M = part.M.reshape(-1, design.width)
            self.H += M.T @ M
            right += part.w.reshape(-1) @ M
            square += float((part.w**2).sum())
            logdet -= float(np.log(np.diagonal(part.L_inverse, axis1=-2, axis2=-1)).sum())
            if len(slices) == 1:
                self._whitened.append(part)
        w, rows = self._distances()
        if len(w):
            self.H += rows.T @ rows
            right += w @ rows
            square += float(w @ w)
        effects = np.arange(flat, design.width)
        self.H[effects, effects] += 1.0
        self.half, determinant = inverse_root(self.H)
        self.coefficients = -(self.half @ (self.half.T @ right))
        # One step of iterative refinement, because the inverse of H loses digits.
        residual = right + self.H @ self.coefficients
        self.coefficients -= self.half @ (self.half.T @ residual)
        # NaN stays NaN; `max` would return 0, the best of all fits.
        self.chi2 = float(np.maximum(0.0, square + right @ self.coefficients))
        self.change = self.coefficients[design.column] * self.unit
        self.unit_b = self.coefficients[flat:]
        self.b = self.unit_b * self.root
        self.dof = system.equations - flat
        self.log_likelihood = -0.5 * (2.0 * logdet + determinant + self.chi2)

    @cached_property
    def H_inverse(self) -> FloatArray:
        """Inverse of H (width, width)."""
        return np.asarray(self.half @ self.half.T)

    def _distances(self) -> tuple[FloatArray, FloatArray]:
        """Return the distances' misclosures (k,), and derivatives (k, width) with respect to all coefficients."""
        w, rates = self.system.distances
        rows = np.zeros((len(w), self.design.width))
        if len(w):
            rows[:, self.design.column] = rates * self.unit
        return w, rows

    def distance_deviations(self) -> FloatArray:
        """Return the k measured distances minus their predictions from all other data, in sigmas of the differences."""
        w, rows = self._distances()
        known = 1.0 - ((rows @ self.half) ** 2).sum(-1)
        return np.asarray(-(w + rows @ self.coefficients) / np.sqrt(np.maximum(known, 1e-12)))

    def chi2_without_distances(self, chosen: IntArray) -> float:
        """Return chi2 of the fit without the measured distances `chosen` (indices)."""
        w, rows = self._distances()
        left = (w + rows @ self.coefficients)[chosen]
        inside = rows[chosen] @ self.half
        known = np.eye(len(left)) - inside @ inside.T
        return self.chi2 - float(left @ np.linalg.lstsq(known, left, rcond=1e-12)[0])

    def _whiten(self, poses: slice) -> Whitened:
        return self.design.whiten(self.system.at_poses(poses), self.v, self.root, poses)

    def parts(self) -> Iterator[Whitened]:
        """Yield the whitened equations for some poses at a time; the effects' columns are scaled to unit variance."""
        yield from self._whitened or (self._whiten(poses) for poses in self.design.parts())

    def residual(self, part: Whitened) -> FloatArray:
        """Return the whitened residuals (m, r) of some poses."""
        return part.w + part.times(self.coefficients)

    def orthonormal(self, part: Whitened) -> FloatArray:
        """Return ``M half`` (m, r, width) of some poses. Over all equations and priors, its columns are orthonormal."""
        from scipy.linalg import blas

        M = part.M.reshape(-1, self.design.width)
        return np.asarray(blas.dtrmm(1.0, self.half, M.T, trans_a=1).T.reshape(part.M.shape))

    def leverage(self, part: Whitened) -> tuple[FloatArray, FloatArray]:
        """Return ``M H^-1`` (m, r, width) for some poses, and each pose's block (m, r, r) of P (see the class)."""
        gain = part.times(self.H_inverse)
        return gain, np.eye(part.w.shape[1]) - gain @ np.swapaxes(part.M, -1, -2)

    def _columns(self, G: FloatArray) -> Iterator[tuple[Whitened, FloatArray]]:
        """Yield the whitened equations of some poses at a time (`parts`), each with the columns `G` at these poses.

        The columns (m r, k) are whitened too. They have a row for each of the r equations of each of the m poses.
        """
        for part in self.parts():
            yield part, (part.L_inverse @ G[part.poses]).reshape(-1, G.shape[-1])

    @property
    def whole(self) -> System:
        """The equations of all poses at once."""
        return self.system.at_poses(slice(0, len(self.design.q)))

    def at_poses(self, poses: IntArray) -> LinearFit:
        """Return the linear fit of a selection of poses alone, at the same linearisation and variances."""
        return LinearFit(self.design.at_poses(poses), self.system.at_poses(poses), self.v)

    @cached_property
    def stated(self) -> LinearFit:
        """The linear fit at the same linearisation, with the variances that the files state (`Layout.as_stated`)."""
        return LinearFit(self.design, self.system, self.design.as_stated(self.v))

    @cached_property
    def at_known_noise(self) -> LinearFit:
        """The linear fit at the same linearisation, with the variances at which faults are tested.

        These are the stated variances (`Layout.as_stated`), except for noise. Noise has its estimated variance, limited
        to the range from `Layout.test_floors` to the stated variance. A smaller variance makes tests of single readings
        more powerful, and the upper limit prevents a fault from counting as noise.
        """
        v = self.design.as_stated(self.v)
        noise = self.design.noise_components
        v[noise] = np.clip(self.v, np.minimum(self.design.test_floors, v), v)[noise]
        return LinearFit(self.design, self.system, v)

    @cached_property
    def derivatives(self) -> Derivatives:
        """Derivatives of the likelihood with respect to the variances; the priors of the variances are not included."""
        return likelihood_derivatives(self)

    # ---- uncertainty of the parameters

    @property
    def covariance(self) -> FloatArray:
        """Covariance (P, P) of all parameters, from all sources of error."""
        column = self.design.column
        block = self.H_inverse[np.ix_(column, column)] * np.outer(self.unit, self.unit)
        return np.asarray(0.5 * (block + block.T))

    @property
    def standard_deviation(self) -> FloatArray:
        """Standard deviation (P,) of every parameter."""
        return np.asarray(np.sqrt((self.half[self.design.column] ** 2).sum(-1)) * self.unit)

    @property
    def repeatability(self) -> FloatArray:
        """Covariance (P, P) of the parameters from noise alone: their scatter if the same poses were taken again."""
        gain = self._gain().T
        rows = (part.times(gain).reshape(-1, gain.shape[1]) for part in self.parts())
        return np.asarray(sum(G.T @ G for G in chain(rows, [self._distances()[1] @ gain])))

    def _gain(self) -> FloatArray:
        """Return the rows (P, width) of ``H^-1`` for the parameters, each multiplied by its element of `unit`."""
        return np.asarray(self.H_inverse[self.design.column] * self.unit[:, None])

    def budget(self) -> dict[str, FloatArray]:
        """Return the contribution (P,) of each source to the parameters' variances; the contributions sum to the total.

        Each contribution is exact, because the estimate is linear in the errors. If a source were removed and the fit
        kept its weights, the variances would decrease by the source's contribution.
        """
        design, gain = self.design, self._gain()
        variances: dict[str, FloatArray] = {}

        def add(source: str, values: FloatArray) -> None:
            variances[source] = variances.get(source, np.zeros(len(gain))) + values

        for g, where in zip(design.groups, design.slices, strict=True):
            share = (gain[:, where] ** 2).sum(-1)
            of_group = g.variance(self.v)
            unnamed = sum(
                rate * self.v[c]
                for c, rate in g.rates
                if design.components[c].name == "discrepancy"
            )
            add(g.source, share * (1.0 - unnamed / of_group))
            if unnamed:
                add("discrepancy", share * unnamed / of_group)
        for part in self.parts():
            squares = (np.swapaxes(part.C, -1, -2) @ part.times(gain.T)) ** 2
            sources = design.noise_sources(part.poses)
            by_source = np.tensordot(sources.variances(self.v), squares, 2)
            for name, contribution in zip(sources.names, by_source, strict=True):
                add(name, contribution)
        rows = self._distances()[1]
        if len(rows):
            add("distances", ((gain @ rows.T) ** 2).sum(-1))
        return variances

    # ---- predictions between poses, and effects outside the model

    def score(self, G: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the score ``s = G' P w`` (k,) of new columns `G` (m, r, k), and its covariance ``C = G' P G`` (k, k).

        The class explains P and w. `G` is not yet whitened. If the model contained these columns, their coefficients
        would be ``-C^-1 s``, and chi2 would be smaller by ``s' C^-1 s``.
        """
        k = G.shape[-1]
        Gw, GG, GM = np.zeros(k), np.zeros((k, k)), np.zeros((k, self.design.width))
        for part, white in self._columns(G):
            Gw += part.w.reshape(-1) @ white
            GG += white.T @ white
            GM += white.T @ part.M.reshape(-1, self.design.width)
        return Gw + GM @ self.coefficients, GG - GM @ self.H_inverse @ GM.T

    def moved_by(self, G: FloatArray) -> FloatArray:
        """Return the change (P, k) of every parameter caused by each of k errors that the model does not contain.

        Column i of `G` (m, r, k) is what error i adds to the misclosures. The changes are rows of ``-H^-1 M'G``.
        """
        MG = np.zeros((self.design.width, G.shape[-1]))
        for part, white in self._columns(G):
            MG += part.M.reshape(-1, self.design.width).T @ white
        return np.asarray(-self._gain() @ MG)

    def held_out_chi2(self, *parts: IntArray) -> list[tuple[float, int]]:
        """Return (chi2, dof) for each group of poses (indices in `parts`): misfit to the prediction from all others.

        No refit is needed: chi2 is ``(P w)_F' P_FF^-1 (P w)_F``, with P the projector and F the group's equations.
        """
        rows = [(self.orthonormal(part), self.residual(part)) for part in self.parts()]
        N, residual = (np.concatenate(arrays) for arrays in zip(*rows, strict=True))
        return [
            _held_out(N[poses].reshape(-1, self.design.width), residual[poses].reshape(-1))
            for poses in parts
        ]

    def without_each(self) -> FloatArray:
        """Return the changes (m, P) of the parameters if each pose in turn is left out and the variances stay the same.

        No refit is needed. With M the whitened rows of the pose and e its residual, the coefficients of the columns
        change by ``H^-1 M' (I - M H^-1 M')^-1 e`` (matrix inversion lemma). The second inverse is a pseudo-inverse: in
        directions that only this pose determines, nothing changes.
        """
        steps = []
        for part in self.parts():
            gain, P = self.leverage(part)
            pull = np.linalg.pinv(P, rcond=1e-9, hermitian=True) @ self.residual(part)[..., None]
            steps.append((np.swapaxes(gain[..., self.design.column], -1, -2) @ pull)[..., 0])
        return np.asarray(np.concatenate(steps) * self.unit)

    @property
    def pulls(self) -> FloatArray:
        """Predicted coefficient of each effect, divided by the standard deviation of the prediction.

        Each of the f effects has a pull (f,). A pull is ~ N(0, 1) if the model is right, and 0 if the poses give no
        information about the effect.
        """
        remaining = np.diagonal(self.H_inverse)[self.design.flat_count :]
        z = self.unit_b / np.sqrt(np.maximum(1.0 - remaining, 1e-12))
        return np.where(remaining < 1.0 - LEAST_PULL_INFORMATION, z, 0.0)

    def pull_covariance(self, effects: IntArray) -> FloatArray:
        """Return the covariance (k, k) that the `pulls` of `effects` (k indices) have if the model is right.

        If the poses determine only the sum of some effects, their pulls are correlated. The rows of effects about which
        the poses give no information are zero.
        """
        columns = self.design.flat_count + effects
        determined = np.eye(len(columns)) - self.H_inverse[np.ix_(columns, columns)]
        square = np.diagonal(determined)
        known = square > LEAST_PULL_INFORMATION
        scale = np.where(known, 1.0 / np.sqrt(np.where(known, square, 1.0)), 0.0)
        return np.asarray(determined * np.outer(scale, scale))


def _held_out(N: FloatArray, residual: FloatArray) -> tuple[float, int]:
    """Return chi2 of R held-out equations, and its degrees of freedom.

    `N` (R, width): the rows of `orthonormal` for these equations. `residual` (R,): their residuals r.
    With V = I - N N', chi2 is ``r' V^-1 r`` (pseudo-inverse if V is singular), with rank(V) degrees of freedom. If
    I - N'N is the smaller matrix, its eigenvalues are calculated instead, which are those of V apart from ones, and
    chi2 follows from ``V^-1 = I + N (I - N'N)^-1 N'``.
    """
    few = len(N) <= N.shape[1]
    values, vectors = np.linalg.eigh(np.eye(min(N.shape)) - (N @ N.T if few else N.T @ N))
    free = values > FREE
    # Chi2 is r'r plus a sum over the eigenvectors; along those that no other pose predicts, it takes r out.
    weights = np.where(free, 1.0 / np.where(free, values, 1.0) - few, -1.0)
    chi2 = residual @ residual + weights @ ((residual if few else residual @ N) @ vectors) ** 2
    return float(chi2), len(N) - int((~free).sum())


def inverse_root(H: FloatArray) -> tuple[FloatArray, float]:
    """Return the upper triangular root K of the inverse, ``H^-1 = K K'``, and the logarithm of H's determinant.

    K is from Cholesky's method if possible, which is accurate even if the units of columns differ greatly.
    """
    from scipy.linalg import lapack, rq

    # H is symmetric, so its transpose is H in LAPACK's column order and needs no copy.
    factor, failed = lapack.dpotrf(H.T)
    if not failed:
        root = np.asarray(lapack.dtrtri(factor, overwrite_c=True)[0])
        return root, -2.0 * float(np.log(np.diagonal(root)).sum())
    # An undetermined direction gets a correspondingly large variance.
    unit = 1.0 / np.sqrt(np.maximum(np.diagonal(H), 1e-300))
    values, vectors = np.linalg.eigh(H * np.outer(unit, unit))
    values = np.maximum(values, 1e-14 * values[-1])
    logdet = float(np.log(values).sum() - 2.0 * np.log(unit).sum())
    return rq(unit[:, None] * vectors / np.sqrt(values), mode="r", check_finite=False), logdet
