"""Telling poses apart that close with the hand upside down on the hinge: named, never mixed in.

Knows closure models and the paper's estimator; no file and no screen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.chain.parameters import nominal_vector
from solver.estimators.estimate import Estimate
from solver.estimators.goodness import closure_at_readings
from solver.estimators.paper import estimate_paper
from solver.loops.closure import ClosureModel


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Branches:
    """Which poses lie on the main branch.

    Attributes
    ----------
    kept
        (m,): those that do.
    flipped
        Indices of the others.
    paper
        The paper's estimate from the kept poses, where telling them apart has made just that, with all
        joints sensed.
    """

    kept: BoolArray
    flipped: tuple[int, ...]
    paper: Estimate | None = None

    @classmethod
    def without(cls, flipped: tuple[int, ...], poses: int) -> Branches:
        """All of so many poses but these."""
        kept = np.ones(poses, dtype=np.bool_)
        kept[list(flipped)] = False
        return cls(kept=kept, flipped=flipped)


def on_main_branch(model: ClosureModel, q: FloatArray) -> Branches:
    """Tell poses (m, n), rad, on the main branch of the hinge from those on the other.

    Told apart at the nominal placement, where the hand of a flipped pose is upside down whatever
    the last degrees are; a fit through poses of both branches would be dragged between them.
    """
    everything = Branches.without((), len(q))
    # Readings that are not believed to a degree are still good enough to tell up from down.
    model = model.with_all_joints_sensed()
    if len(q) * model.equations_per_pose <= len(model.parameters):
        return everything
    keep = ~closure_at_readings(model, nominal_vector(model.parameters), q).flipped
    if 2 * int(keep.sum()) < len(q):
        keep = ~keep
    if bool(keep.all()):
        judged = estimate_paper(model, q)
        if not judged.flipped:
            return Branches(kept=keep, flipped=(), paper=judged)
        keep[list(judged.flipped)] = False
    part = model.at_poses(np.flatnonzero(keep))
    if int(keep.sum()) * model.equations_per_pose <= len(model.parameters):
        return everything
    paper = estimate_paper(part, q[keep])
    flipped = closure_at_readings(model, paper.x, q).flipped
    return Branches(
        kept=~flipped,
        flipped=tuple(int(k) for k in np.flatnonzero(flipped)),
        paper=paper if np.array_equal(keep, ~flipped) else None,
    )
