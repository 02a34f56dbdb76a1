"""Effects that repeat at the same pose: sides of play, sag and deflection, as shapes over the poses.

By load where masses are stated (`solver.estimators.load_effects`), any smooth function of the pose where
they are not. Shapes have coefficients ~ N(0, 1); the rest of a stated variance is independent in every pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.estimators.compliance import PoseBasis
from solver.estimators.error_model import ErrorModel
from solver.estimators.load_effects import LoadBasis

UNMODELLED_SHARE = 0.15
"""Share of the variance of a stated sag or deflection that the stated loads do not explain."""

BY_APPROACH = 0.5
"""Probability that play follows the direction of approach; otherwise it follows the load."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shapes:
    """Shapes (m, d, c) along d joints, and the variance they leave (m, d).

    `expected` (m, d) is the expected value, from which the shapes deviate. In units of the stated size of each joint.
    """

    columns: FloatArray
    missed: FloatArray
    expected: FloatArray

    @property
    def width(self) -> int:
        """Number c of shapes of one joint."""
        return int(self.columns.shape[-1])


def sides_of_play(q: FloatArray, errors: ErrorModel) -> Shapes:
    """Sides of play: that of the load where it is known, and that of the approach.

    It is unknown which of the two a joint follows. If the load, its link rests where gravity moves it: with a
    probability of p it is there, the mean is p, and the rest of the variance, 1 - p^2, is a deviation from that. If the
    approach, it is unknown whether link or drive leads: both sides are equally likely.
    """
    by_load = np.ones_like(q) if errors.loads is None else errors.loads.side
    signed = errors.signed and errors.loads is not None
    expected = (1.0 - BY_APPROACH if signed else 0.0) * by_load
    shares, sides = [1.0], [by_load]
    if errors.approach is not None:
        shares, sides = [1.0 - BY_APPROACH, BY_APPROACH], [by_load, errors.approach]
    if signed:
        shares[0] -= (1.0 - BY_APPROACH) ** 2
    columns = np.sqrt(shares) * np.stack(sides, axis=-1)
    return Shapes(
        columns=columns, missed=1.0 - (columns**2).sum(-1) - expected**2, expected=expected
    )


def shapes_of_sag(q: FloatArray, errors: ErrorModel, basis: PoseBasis) -> Shapes:
    """Twist of every joint under gravity."""
    loads, (m, n) = errors.loads, q.shape
    if loads is None:
        return Shapes(
            columns=np.broadcast_to(basis.phi[:, None], (m, n, basis.phi.shape[1])),
            missed=np.broadcast_to(basis.missed[:, None], (m, n)),
            expected=np.zeros((m, n)),
        )
    columns, expected = loads.sag, loads.sag_expected
    if not errors.signed:
        # The same second moments about zero.
        columns = np.concatenate((columns, expected[..., None]), axis=-1)
        expected = np.zeros_like(expected)
    return Shapes(
        columns=np.sqrt(1.0 - UNMODELLED_SHARE) * columns,
        missed=(1.0 - UNMODELLED_SHARE) * loads.sag_missed + UNMODELLED_SHARE,
        expected=np.sqrt(1.0 - UNMODELLED_SHARE) * expected,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoadedGive:
    """Deflection of a fixture of stated `sizes` (k,), rad and m, under load, without the share `UNMODELLED_SHARE`.

    Its shapes are the largest of all and are scaled for some poses at a time.
    """

    loads: LoadBasis
    sizes: FloatArray

    @property
    def width(self) -> int:
        """Number c of shapes."""
        return int(self.loads.all_give.shape[-1])

    def columns(self, poses: slice) -> FloatArray:
        """Shapes (m, k, c) along the closure components."""
        scale = np.sqrt(1.0 - UNMODELLED_SHARE) * self.sizes
        return np.asarray(scale[:, None] * self.loads.give_at(poses))

    def missed(self, poses: slice) -> FloatArray:
        """Variance (m, k) that they leave out."""
        return np.asarray((1.0 - UNMODELLED_SHARE) * self.sizes**2 * self.loads.give_missed[poses])


def loaded_give(errors: ErrorModel, sizes: FloatArray) -> LoadedGive | None:
    """Return the deflection under load; None where loads are unknown or zero, or no compliance is stated."""
    if errors.loads is None or not sizes.any() or not errors.loads.all_give.any():
        return None
    return LoadedGive(loads=errors.loads, sizes=sizes)
