"""The closed loops of a pose set, the poses on the main branch, and the parameters that these identify; refusals."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fixtures.base import EndpointConstraint, SetupCheck, Severity
from fixtures.errors import FixtureError
from solver.arrays import BoolArray, FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import DhEntry, DhKind, is_entry, nominal_vector
from solver.chain.poses import PoseSet
from solver.diagnostics.identifiability import Identifiability
from solver.diagnostics.limits import FEW_DOF
from solver.diagnostics.model_selection import drop_unidentifiable
from solver.errors import UnidentifiableError
from solver.estimators.estimate import Estimate, closure_at_readings, require_enough_poses
from solver.estimators.least_squares import Progress
from solver.estimators.paper import estimate_paper
from solver.loops.closure import ClosureModel
from solver.search.global_start import GlobalStart, global_start


class IdentifiableLoops(NamedTuple):
    """The loops to be fitted, without unidentifiable parameters.

    Attributes
    ----------
    model
        The loops with all unknowns, or with those of `identifiable` if the others are dropped on request.
    identifiable, unidentifiable
        The loops with the unknowns that the poses identify, and the names of the others.
    q, kept, flipped
        Readings (k, n), rad, of the poses on the main branch, a mask (m,) of these, and indices of the others.
    search
        The global start, if requested.
    x0, paper
        First estimates of `identifiable`, if any.
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
    # Files state uncertainties of offsets only: other parameters stay free, and are refused later.
    return (smaller, unidentifiable) if drop or known else (model, ())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Branches:
    """Poses by the branch of the hinge on which they close.

    `kept` (m,): whether each is on the main branch. `flipped`: indices of the others. `paper`: the paper's estimate
    from the kept poses with all joints sensed, if it was computed.
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

    This uses the nominal placement, where the tool of a flipped pose is upside down even with inaccurate nominal
    values; a fit through poses of both branches would lie between them.
    """
    everything = Branches.without((), len(q))
    # Readings with errors of a degree still distinguish the two branches.
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
    found = closure_at_readings(model, paper.x, q)
    kept = ~found.flipped
    return Branches(
        kept=kept,
        flipped=found.flipped_poses,
        paper=paper if np.array_equal(keep, kept) else None,
    )


def pick_placements(poses: PoseSet, placements: tuple[int, ...]) -> PoseSet:
    """Return the poses of some placements; ValueError if one does not exist."""
    missing = sorted(set(placements) - set(poses.placements))
    if missing:
        known = ", ".join(str(p) for p in poses.placements)
        raise ValueError(f"there is no placement {missing[0]}; the file has {known}")
    return poses.at_poses(np.isin(poses.placement, placements))


def in_order(model: ClosureModel, other: ClosureModel, x: FloatArray) -> FloatArray:
    """Parameters (P,) of `model`: those that `other` shares from its `x`, the rest nominal."""
    known = {p.name: float(v) for p, v in zip(other.parameters, x, strict=True)}
    return np.array([known.get(p.name, p.nominal) for p in model.parameters])


class FixtureRefusedError(FixtureError):
    """A set-up check refuses this placement; `checks` say why and what to remount."""

    code = "PARALLEL_AXES"

    def __init__(self, checks: tuple[SetupCheck, ...]) -> None:
        self.checks = checks
        super().__init__("; ".join(f"{c.text}: {c.remedy}" for c in checks))


def require_identifiable(
    seen: Identifiability, model: ClosureModel, poses: int, *, known: Collection[str] = ()
) -> None:
    """Refuse unidentifiable directions of `model`, unless the arm's file states an uncertainty (`known`).

    Raises `UnidentifiableError` if some direction is unidentifiable.
    """
    blind = tuple(d for d in seen.directions if not set(d.parameters) & set(known))
    if blind:
        if poses * model.equations_per_pose - len(model.parameters) < FEW_DOF:
            raise UnidentifiableError(
                blind,
                code="TOO_FEW_POSES",
                note=f"{poses} poses are few: take at least 20",
            )
        raise UnidentifiableError(blind)


def refuse_placement(fixture: EndpointConstraint, arm: ArmModel, model: ClosureModel) -> None:
    """Refuse a nominal placement in which parameters have no unique values (Hayati)."""
    part, *_ = model.parts()[0]
    checks = fixture.placement_checks(arm, part, nominal_vector(part.parameters))
    refused = tuple(c for c in checks if c.severity is Severity.REFUSED)
    if refused and model.parameters:
        raise FixtureRefusedError(refused)


def placement_checks(
    fixture: EndpointConstraint, arm: ArmModel, model: ClosureModel, x: FloatArray
) -> tuple[SetupCheck, ...]:
    """Check the geometry of every placement at the identified parameters `x` of `model`."""
    found: dict[tuple[str, str], SetupCheck] = {}
    for part, columns, _ in model.parts():
        for check in fixture.placement_checks(arm, part, x[columns]):
            found.setdefault((check.code, check.text), check)
    return tuple(found.values())
