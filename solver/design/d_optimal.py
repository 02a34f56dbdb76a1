"""D-optimal choice of poses: the set whose information matrix has the largest determinant.

Poses are added greedily, then exchanged for better candidates until no exchange helps (Fedorov 1972). If the
information is M, a candidate with the square root F (r rows) raises its determinant to
``det(M + F'F) = det(M) det(I + F M^-1 F')``. One product over all candidates and a determinant of size r for each of
them are enough, so a whole sweep takes milliseconds.

Besides the parameters, the unknowns include effects: nuisance parameters that describe stated errors (of lengths,
twists, encoders, play, sag, compliance) and have the prior N(0, 1). Only the determinant of the parameters' information
is maximised (D_s-optimality). A pose adds ``A' V^-1 A`` to the Fisher information (method, section 3). A are the
derivatives of its closure equations with respect to parameters and effects, V is the covariance of these equations. A
thousand similar poses determine the effects no better than one pose does (method, section 10).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.errors import PosesDoNotFitError
from solver.estimators.effects import Linearisation, LinearModel, State
from solver.estimators.error_model import ErrorModel
from solver.estimators.least_squares import column_scale
from solver.loops.closure import ClosureModel

PRIOR_SHARE = 1e-8
"""Weight, relative to an average candidate, of the prior that makes the first information matrices regular."""
MOST_RESTARTS = 24
RESTART_WORK = 400_000
"""Upper limit of the product of restarts, candidates, poses and unknowns. Restarts help in small problems, which have
bad local optima and are cheap. With thousands of candidates, one start comes within one per cent of the optimum."""
MAX_SWEEPS = 10
"""Largest number of sweeps of exchanges."""
WORTHWHILE = 1e-9
"""A gain of log det smaller than this is due to rounding."""


class TooFewCandidatesError(ValueError):
    """Raised if fewer poses can be chosen than were requested."""


def log_det(information: FloatArray) -> float:
    """Log determinant of an information matrix (P, P), computed with the diagonal scaled to 1; -inf if singular."""
    d = np.sqrt(np.diagonal(information))
    if np.any(d <= 0.0):
        return float("-inf")
    sign, value = np.linalg.slogdet(information / np.outer(d, d))
    return float(value + 2.0 * np.log(d).sum()) if sign > 0 else float("-inf")


def summed_information(root: FloatArray, poses: Sequence[int]) -> FloatArray:
    """Return the information (N, N) of `poses` together, from `PoseInformation.root`; repeated poses count again."""
    rows = root[list(poses)].reshape(-1, root.shape[-1])
    return np.asarray(rows.T @ rows)


def gains(root: FloatArray, information: FloatArray, parameters: int) -> FloatArray:
    """Return how much each of m candidates, added alone, increases the log det of the parameters' information, (m,).

    `root` (m, r, N): `PoseInformation.root` of the candidates. `parameters`: the first `parameters` of the N unknowns
    are parameters; the others are effects. `information` (N, N): invertible, and includes the prior of the effects.
    """
    of_effects = _gains(root[..., parameters:], information[parameters:, parameters:])
    return _gains(root, information) - of_effects


def _gains(root: FloatArray, information: FloatArray) -> FloatArray:
    m, r, N = root.shape
    L = np.linalg.cholesky(information)
    white = (root.reshape(m * r, N) @ np.linalg.inv(L).T).reshape(m, r, N)
    square = white @ np.swapaxes(white, -1, -2)
    diagonal = np.linalg.cholesky(square + np.eye(r))[..., range(r), range(r)]
    return np.asarray(2.0 * np.log(diagonal).sum(-1))


def choose_poses(
    root: FloatArray,
    count: int,
    *,
    parameters: int,
    fixed: FloatArray,
    allowed: BoolArray | None = None,
    q: FloatArray | None = None,
    apart_rad: float = 0.0,
    seed: int = 0,
) -> tuple[int, ...]:
    """Return the indices of `count` different candidates whose information, added to `fixed`, has the largest log det.

    Raises `TooFewCandidatesError` if fewer than `count` candidates are allowed and far enough apart.
    `root` (m, r, N): `PoseInformation.root` of all candidates. `parameters`: the first `parameters` of the N unknowns
    are to be determined; the others are effects (see the module). `fixed` (N, N): information that is known already.
    `allowed` (m,): which candidates may be chosen; all by default. `q`, `apart_rad`: joint angles (m, n) of the
    candidates, and the least distance (Euclidean, rad) between chosen candidates. Without this distance, the best set
    consists of near repeats of a few poses, which average sensor noise, but not the sensors' linearity deviations.
    """
    m, _, N = root.shape
    P = parameters
    usable = np.ones(m, dtype=np.bool_) if allowed is None else allowed.copy()
    if count > int(usable.sum()):
        raise TooFewCandidatesError(
            f"{count} poses requested, but there are only {int(usable.sum())} candidate poses"
        )
    # With columns of unit length over all candidates, the average candidate has information 1/m on the diagonal.
    scale, prior = np.ones(N), np.ones(N)
    scale[:P] = column_scale(root[..., :P].reshape(-1, P))
    prior[:P] = PRIOR_SHARE / m
    M = np.diag(prior) + fixed / np.outer(scale, scale)
    search = _Search(root / scale, P, usable, q if apart_rad > 0.0 else None, apart_rad)
    rng = np.random.default_rng(seed)
    best: tuple[float, list[int]] = (-np.inf, [])
    # A single pose needs no restart.
    restarts = min(MOST_RESTARTS, RESTART_WORK // (m * count * N)) if count > 1 else 0
    for start in range(1 + restarts):
        chosen, current = [], M.copy()
        if start > 0:
            # Half of the poses are chosen at random and the rest greedily: this leads to another good local optimum.
            chosen = search.random_start(count // 2, rng)
            current += summed_information(search.root, chosen)
        search.fill(current, chosen, count)
        search.exchange(current, chosen)
        value = log_det(current) - log_det(current[P:, P:])
        if start == 0 or value > best[0] + WORTHWHILE:
            best = value, chosen
    return tuple(best[1])


@dataclass(frozen=True, slots=True)
class _Search:
    """Greedy choice of poses from m candidates, and exchange of chosen ones for others.

    `root` (m, r, N): `PoseInformation.root` of the candidates, with the N unknowns scaled to similar size.
    `parameters`: number of unknowns that are parameters; they come first. The others are coefficients of effects.
    """

    root: FloatArray
    parameters: int
    usable: BoolArray
    q: FloatArray | None
    apart_rad: float

    def open(self, chosen: Sequence[int]) -> BoolArray:
        usable = self.usable.copy()
        usable[list(chosen)] = False
        if self.q is not None:
            for pose in chosen:
                usable &= ((self.q - self.q[pose]) ** 2).sum(-1) >= self.apart_rad**2
        return usable

    def gains(self, M: FloatArray, beside: Sequence[int]) -> FloatArray:
        return np.where(self.open(beside), gains(self.root, M, self.parameters), -np.inf)

    def random_start(self, count: int, rng: np.random.Generator) -> list[int]:
        chosen: list[int] = []
        for _ in range(count):
            if len(candidates := np.flatnonzero(self.open(chosen))):
                chosen.append(int(rng.choice(candidates)))
        return chosen

    def fill(self, M: FloatArray, chosen: list[int], count: int) -> None:
        """Add the best candidates to `chosen`, up to `count` in all, and their information to `M` (N, N)."""
        while len(chosen) < count:
            gain = self.gains(M, chosen)
            best = int(np.argmax(gain))
            if not np.isfinite(gain[best]):
                raise TooFewCandidatesError(
                    f"only {len(chosen)} of {count} poses keep {self.apart_rad:.3f} rad from each other"
                )
            M += summed_information(self.root, [best])
            chosen.append(best)

    def exchange(self, M: FloatArray, chosen: list[int]) -> None:
        """Exchange poses in `chosen` for better candidates until there are none; update the information `M` (N, N)."""
        for _ in range(MAX_SWEEPS):
            changed = False
            for k, old in enumerate(chosen):
                without = M - summed_information(self.root, [old])
                gain = self.gains(without, [pose for pose in chosen if pose != old])
                stay = float(gains(self.root[old : old + 1], without, self.parameters)[0])
                best = int(np.argmax(gain))
                if gain[best] > stay + WORTHWHILE:
                    M[:] = without + summed_information(self.root, [best])
                    chosen[k] = best
                    changed = True
            if not changed:
                break


EFFECTS = 40
"""Number of combinations of effects used in planning. The combinations that the poses determine best are used: on the
built-in arms they carry 99.9 % of the information, and a choice among 3,000 poses takes one second."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseInformation:
    """Information of each of m poses about P parameters and K effects (nuisance parameters, see the module).

    `parameters`: names, in column order. `root` (m, r, P + K): square root of the information, which is ``root' root``
    for each pose. It is ``L^-1 [A, Z]``, with ``L L'`` the covariance of the pose's r closure equations, A their
    derivatives with respect to the parameters, and Z those with respect to the effects.
    """

    parameters: tuple[str, ...]
    root: FloatArray

    def of(self, poses: Sequence[int]) -> FloatArray:
        """Return the information (P + K, P + K) of `poses` (indices) together; a pose listed twice counts twice."""
        return summed_information(self.root, poses)

    def about(self, parameters: Sequence[str]) -> PoseInformation:
        """Return the information about `parameters` and the K effects only; all other parameters count as known."""
        columns = [self.parameters.index(name) for name in parameters]
        columns += range(len(self.parameters), self.root.shape[-1])
        return replace(self, parameters=tuple(parameters), root=self.root[..., columns])


def pose_information(
    model: ClosureModel,
    x: FloatArray,
    q: FloatArray,
    closed_q: FloatArray,
    closed_u: FloatArray,
    errors: ErrorModel,
    variances: Mapping[str, float] | None = None,
) -> PoseInformation:
    """Return the information of m poses about the parameters of `model` and the effects (nuisance parameters).

    A parameter for which `errors` states a tolerance or a prior counts as an effect, not as a parameter.
    Raises `ValueError` if a closure component has no noise at all (exact joints and a stiff fixture).
    `x`: values of all parameters. `q` (m, n): readings of captured or planned poses. `closed_q` (m, n), `closed_u`
    (m, U): joint angles and unsensed angles, rad, of the nearest poses at which the loop closes. `variances`: variance
    components of `errors` by name; by default their start values.
    """
    design = LinearModel(model, q, errors)
    equations = Linearisation(
        design, State(x=x, e=closed_q - q, u=closed_u, closed_q=closed_q, closed_u=closed_u)
    )
    sizes = design.start_variances() if variances is None else design.variances_by_name(variances)
    root = np.sqrt(design.group_variances(sizes))
    try:
        parts = [
            design.whiten(equations.at_poses(part), sizes, root, part) for part in design.parts()
        ]
    except PosesDoNotFitError as error:
        raise ValueError(
            "some closure components have no noise, because their joints have none"
        ) from error
    columns = np.concatenate([p.M for p in parts])
    effects = columns[..., design.flat_count :]
    # Leading combinations of independent effects are independent effects again.
    rows = np.concatenate(list(effects))
    _, turn = np.linalg.eigh(rows.T @ rows)
    leading = effects @ turn[:, : -EFFECTS - 1 : -1]
    return PoseInformation(
        parameters=tuple(model.parameters[k].name for k in design.flat_index),
        root=np.concatenate((columns[..., : design.flat_count], leading), axis=-1),
    )
