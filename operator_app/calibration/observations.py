"""Poses on the main branch of the hinge, the parameters they identify, and first estimates of these."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import DhEntry, DhKind, is_entry, nominal_vector
from solver.chain.poses import PoseSet
from solver.diagnostics.model_selection import drop_unidentifiable
from solver.estimators.estimate import Estimate, require_enough_poses
from solver.estimators.goodness import closure_at_readings
from solver.estimators.least_squares import Progress
from solver.estimators.paper import estimate_paper
from solver.loops.closure import ClosureModel
from solver.search.global_start import GlobalStart, global_start


class IdentifiableLoops(NamedTuple):
    """The loops that are fitted, without unidentifiable parameters.

    Attributes
    ----------
    model
        The loops with all unknowns; with those of `identifiable` where the others are dropped on request.
    identifiable, unidentifiable
        The loops with the unknowns that the poses identify, and the names of the others.
    q, kept, flipped
        Readings (k, n), rad, of the poses on the main branch, which these are (m,), and indices of the others.
    search
        The global start, where one was asked for.
    x0, paper
        First estimates of `identifiable`, where there are any.
    """

    model: ClosureModel
    identifiable: ClosureModel
    q: FloatArray
    kept: BoolArray
    flipped: tuple[int, ...]
    unidentifiable: tuple[str, ...]
    search: GlobalStart | None
    x0: FloatArray | None
    paper: Estimate | None


def identifiable_loops(
    model: ClosureModel,
    arm: ArmModel,
    poses: PoseSet,
    *,
    sensed: bool,
    search: bool,
    drop: bool,
    progress: Progress | None,
) -> IdentifiableLoops:
    """Choose the poses of one branch and the parameters they identify; estimate these where all joints are `sensed`."""
    found = global_start(model, poses.q_rad, progress=progress) if search else None
    branches = (
        on_main_branch(model, poses.q_rad)
        if found is None
        else Branches.without(found.set_aside, len(poses))
    )
    kept, flipped = branches.kept, branches.flipped
    model, q = model.at_poses(np.flatnonzero(kept)), poses.q_rad[kept]
    require_enough_poses(model, len(q))
    x0 = None if found is None else found.x
    every_unknown = model
    model, unidentifiable = _without_unidentifiable(model, arm, x0, q, drop=drop)
    if unidentifiable:
        require_enough_poses(model, len(q))
        if search:
            # The fixed parameters have other values than in the search: it is repeated without them.
            found = global_start(model, q, progress=progress)
        x0 = None if found is None else found.x
    paper = None
    if sensed:
        made = branches.paper if x0 is None and not unidentifiable else None
        paper = made or estimate_paper(model, q, x0=x0)
    return IdentifiableLoops(
        model if drop else every_unknown, model, q, kept, flipped, unidentifiable, found, x0, paper
    )


def _without_unidentifiable(
    model: ClosureModel, arm: ArmModel, x0: FloatArray | None, q: FloatArray, *, drop: bool
) -> tuple[ClosureModel, tuple[str, ...]]:
    """Fix unidentifiable parameters: on request, or where the arm's file states their uncertainty."""
    if not drop and arm.offset_tolerance_rad is None:
        return model, ()
    smaller, unidentifiable = drop_unidentifiable(model, x0, q, sigma_rad=arm.sigma_rad())
    known = all(is_entry(n) and DhEntry.parse(n).kind is DhKind.THETA_OFF for n in unidentifiable)
    # No file states anything of parameters other than offsets: they stay, and are refused later.
    return (smaller, unidentifiable) if drop or known else (model, ())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Branches:
    """Poses by the branch of the hinge on which they close.

    Attributes
    ----------
    kept
        (m,): those on the main branch.
    flipped
        Indices of the others.
    paper
        The paper's estimate from the kept poses with all joints sensed, where it was made on the way.
    """

    kept: BoolArray
    flipped: tuple[int, ...]
    paper: Estimate | None = None

    @classmethod
    def without(cls, flipped: tuple[int, ...], poses: int) -> Branches:
        """Return all poses but the flipped ones."""
        kept = np.ones(poses, dtype=np.bool_)
        kept[list(flipped)] = False
        return cls(kept=kept, flipped=flipped)


def on_main_branch(model: ClosureModel, q: FloatArray) -> Branches:
    """Separate poses (m, n), rad, on the main branch of the hinge from those on the other.

    At the nominal placement, where the tool of a flipped pose is upside down however inaccurate the nominal
    values are; a fit through poses of both branches would lie between them.
    """
    everything = Branches.without((), len(q))
    # Readings with errors of a degree still tell up from down.
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
