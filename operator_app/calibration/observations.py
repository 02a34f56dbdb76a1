"""Poses on the main branch of the hinge, the parameters they identify, and first estimates of these."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import DhEntry, DhKind, is_entry, nominal_vector
from solver.chain.poses import PoseSet
from solver.diagnostics.parameter_selection import drop_unidentifiable
from solver.estimators.estimate import Estimate, require_enough_poses
from solver.estimators.goodness import closure_at_readings
from solver.estimators.least_squares import Progress
from solver.estimators.paper import estimate_paper
from solver.loops.closure import ClosureModel
from solver.search.global_start import GlobalStart, global_start


class SeenLoops(NamedTuple):
    """The loops that are fitted, with what is not seen taken out.

    `q` (k, n) and `kept` (m,) are the poses on the main branch, `flipped` the others; `blind` is what poses alone
    leave open, and `alone` the loops without it; `search` is the global start, where one was asked for; `x0` and
    `paper` are first estimates of `alone`, where there are.
    """

    model: ClosureModel
    alone: ClosureModel
    q: FloatArray
    kept: BoolArray
    flipped: tuple[int, ...]
    blind: tuple[str, ...]
    search: GlobalStart | None
    x0: FloatArray | None
    paper: Estimate | None


def seen_loops(
    model: ClosureModel,
    arm: ArmModel,
    poses: PoseSet,
    *,
    sensed: bool,
    search: bool,
    drop: bool,
    progress: Progress | None,
) -> SeenLoops:
    """Choose the poses of one branch and the parameters that they see; estimate first where all are `sensed`."""
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
    whole, (model, blind) = model, _without_blind(model, arm, x0, q, drop=drop)
    if blind:
        require_enough_poses(model, len(q))
        if search:
            # What is held now has other values than in the search: it is done again without it.
            found = global_start(model, q, progress=progress)
        x0 = None if found is None else found.x
    paper = None
    if sensed:
        made = branches.paper if x0 is None and not blind else None
        paper = made or estimate_paper(model, q, x0=x0)
    return SeenLoops(model if drop else whole, model, q, kept, flipped, blind, found, x0, paper)


def _without_blind(
    model: ClosureModel, arm: ArmModel, x0: FloatArray | None, q: FloatArray, *, drop: bool
) -> tuple[ClosureModel, tuple[str, ...]]:
    """Take out what the poses cannot see: on request, or because the arm's file says how well it is known."""
    if not drop and arm.offset_tolerance_rad is None:
        return model, ()
    smaller, blind = drop_unidentifiable(model, x0, q, sigma_rad=arm.sigma_rad())
    known = all(is_entry(n) and DhEntry.parse(n).kind is DhKind.THETA_OFF for n in blind)
    # Of others than offsets no file states anything: they are asked for and cannot be had.
    return (smaller, blind) if drop or known else (model, ())


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
