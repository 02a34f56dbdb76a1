"""Telling poses apart that close with the hand upside down on the hinge: named, never mixed in.

Knows closure models and the paper's estimator; no file and no screen.
"""

from __future__ import annotations

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.chain.parameters import nominal_vector
from solver.estimators.goodness import closure_at_readings
from solver.estimators.paper import estimate_paper
from solver.loops.closure import ClosureModel


def set_aside(flipped: tuple[int, ...], poses: int) -> tuple[BoolArray, tuple[int, ...]]:
    """Poses that the global start put on the main branch, and the indices of the others."""
    kept = np.ones(poses, dtype=np.bool_)
    kept[list(flipped)] = False
    return kept, flipped


def on_main_branch(model: ClosureModel, q: FloatArray) -> tuple[BoolArray, tuple[int, ...]]:
    """Poses on the main branch of the hinge, and the indices of those on the other.

    Told apart at the nominal placement, where the hand of a flipped pose is upside down whatever
    the last degrees are; a fit through poses of both branches would be dragged between them.
    """
    everything = np.ones(len(q), dtype=np.bool_)
    # Readings that are not believed to a degree are still good enough to tell up from down.
    model = model.with_all_joints_sensed()
    if len(q) * model.equations_per_pose <= len(model.parameters):
        return everything, ()
    keep = ~closure_at_readings(model, nominal_vector(model.parameters), q).flipped
    if 2 * int(keep.sum()) < len(q):
        keep = ~keep
    if bool(keep.all()):
        judged = estimate_paper(model, q).flipped
        if not judged:
            return everything, ()
        keep[list(judged)] = False
    part = model.at_poses(np.flatnonzero(keep))
    if int(keep.sum()) * model.equations_per_pose <= len(model.parameters):
        return everything, ()
    flipped = closure_at_readings(model, estimate_paper(part, q[keep]).x, q).flipped
    return ~flipped, tuple(int(k) for k in np.flatnonzero(flipped))
