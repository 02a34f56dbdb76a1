"""An experiment: poses of an arm in a fixture, their closed loops, and the identifiable parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from fixtures.base import EndpointConstraint, SetupCheck, Severity
from fixtures.errors import FixtureError
from fixtures.measured import Measured
from solver.arrays import BoolArray, FloatArray, IntArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import DhEntry, DhKind, is_entry, nominal_vector
from solver.chain.poses import PoseSet
from solver.chain.rotations import rotation_matrix
from solver.diagnostics.model_selection import drop_unidentifiable
from solver.errors import SolverError
from solver.estimators.estimate import Estimate, closure_at_readings, require_enough_poses
from solver.estimators.least_squares import Progress
from solver.estimators.paper import estimate_paper
from solver.loops.closure import ClosureModel
from solver.loops.endpoints import MeasuredClosure
from solver.loops.placements import place
from solver.search.global_start import GlobalStart, global_start

ANGLES_TRIED = 36
"""Number of angles that are tried for a joint without a sensor."""


class EndpointMissingError(SolverError):
    """The fixture is an instrument, but the poses have no endpoints or, with `orientation`, no orientations."""

    def __init__(self, *, orientation: bool = False) -> None:
        what, columns = "endpoints", "x_m,y_m,z_m"
        if orientation:
            what, columns = "orientations", "rx_deg,ry_deg,rz_deg or qw,qx,qy,qz"
        super().__init__(
            f"the poses have no {what} measured by the instrument: add the columns {columns} (from Python: endpoint_m)"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Experiment:
    """Poses of an arm in a fixture; readings of the joints `unsensed` (1-based) are not used."""

    arm: ArmModel
    fixture: EndpointConstraint
    poses: PoseSet
    unsensed: tuple[int, ...] = ()

    def at_poses(self, poses: IntArray | BoolArray) -> Experiment:
        """Return the experiment with the selected poses (mask, or indices in the desired order)."""
        return replace(self, poses=self.poses.at_poses(poses))

    def loop(self) -> ClosureModel:
        """Return the closure model of all poses, bound to their placements and measurements.

        Raises `EndpointMissingError` if the instrument's columns are missing from the pose set.
        """
        poses, endpoint = self.poses, self.poses.endpoint
        model = self.fixture.model(self.arm, unsensed_joints=self.unsensed)
        if isinstance(model, MeasuredClosure):
            if endpoint is None or (model.full_pose and endpoint.shape[1] < 6):
                raise EndpointMissingError(orientation=endpoint is not None)
            rotation = rotation_matrix(endpoint[:, 3:6]) if model.full_pose else None
            model = model.with_endpoints(endpoint[:, :3], rotation)
        if len(poses.placements) == 1:
            return model
        return place(model, poses.placement, same_hand=self.fixture.stays_on_hand)


def with_angles_of_unsensed(arm: ArmModel, fixture: EndpointConstraint, poses: PoseSet) -> PoseSet:
    """Return the poses; each joint without a sensor gets the angle at which the loop closes best.

    A poses file has a number for such a joint too. If the number is far from the joint's angle, the loop closes wrongly
    or not at all. `ANGLES_TRIED` angles over the joint's range are tried at the nominal parameters; 1 m of closure
    error counts like 1 rad. With an instrument, whose base may be unknown, nothing is changed.
    """
    if not arm.unsensed_joints or isinstance(fixture, Measured):
        return poses
    model = Experiment(arm=arm, fixture=fixture, poses=poses, unsensed=arm.unsensed_joints).loop()
    x, q = nominal_vector(model.parameters), poses.q_rad.copy()
    lower, upper = arm.lower_rad, arm.upper_rad
    blind = [j - 1 for j in arm.unsensed_joints]
    q[:, blind] = 0.5 * (lower + upper)[blind]
    for j in blind:
        angles, errors = np.linspace(lower[j], upper[j], ANGLES_TRIED), []
        for angle in angles:
            q[:, j] = angle
            error = model.loop(x, q, model.initial_unsensed(x, q)).residual
            errors.append(np.linalg.norm(error, axis=-1))
        q[:, j] = angles[np.argmin(errors, axis=0)]
    return replace(poses, q_rad=q)


class IdentifiableLoops(NamedTuple):
    """The loops to be fitted, and the parameters that the poses identify.

    `identifiable`: the loops with the unknowns that the poses identify. `unidentifiable`: names of the other unknowns.
    `model`: the loops with all unknowns; without the unidentifiable ones if these are to be dropped.
    `q` (k, n): readings, rad, of the k poses on the main branch. `kept` (m,): mask of these poses.
    `paper`: the paper's estimate of `identifiable`; None with unsensed joints.
    """

    model: ClosureModel
    identifiable: ClosureModel
    q: FloatArray
    kept: BoolArray
    unidentifiable: tuple[str, ...]
    search: GlobalStart | None
    paper: Estimate | None

    @property
    def flipped(self) -> tuple[int, ...]:
        """Indices of the poses that are not on the main branch."""
        return tuple(np.flatnonzero(~self.kept).tolist())


def identifiable_loops(
    experiment: Experiment,
    model: ClosureModel,
    *,
    search: bool,
    drop: bool,
    progress: Progress | None,
) -> IdentifiableLoops:
    """Choose the poses of one branch and the parameters that they identify; with all joints sensed, estimate these."""
    q, arm, choice, made = experiment.poses.q_rad, experiment.arm, None, None
    if search:
        choice = global_start(model, q, progress=progress)
        is_kept = ~np.isin(np.arange(len(q)), choice.set_aside)
    else:
        is_kept, made = on_main_branch(model, q)
    model, q = model.at_poses(np.flatnonzero(is_kept)), q[is_kept]
    require_enough_poses(model, len(q))
    x0 = None if choice is None else choice.x
    every_unknown, unidentifiable = model, tuple[str, ...]()
    if drop or arm.offset_tolerance_rad is not None:
        smaller, names = drop_unidentifiable(model, x0, q, sigma_rad=arm.sigma_rad())
        # Files state uncertainties of offsets only: without `drop`, other parameters stay free, and are refused later.
        if drop or all(is_entry(n) and DhEntry.parse(n).kind is DhKind.THETA_OFF for n in names):
            model, unidentifiable = smaller, names
    if unidentifiable:
        require_enough_poses(model, len(q))
        if search:
            # Fixing parameters at nominal values affects the others: the search is repeated for the others only.
            choice = global_start(model, q, progress=progress)
    paper = None
    if not experiment.unsensed:
        paper = None if unidentifiable else made
        paper = paper or estimate_paper(model, q, x0=None if choice is None else choice.x)
    loops = model if drop else every_unknown
    return IdentifiableLoops(loops, model, q, is_kept, unidentifiable, choice, paper)


def on_main_branch(model: ClosureModel, q: FloatArray) -> tuple[BoolArray, Estimate | None]:
    """Find the poses on the hinge's main branch, which is the branch with most poses; `q`: readings (m, n), rad.

    Returns a mask (m,) of these poses, and the paper's estimate from these poses, as if all joints were sensed. The
    estimate is None if the poses are too few, or if some poses change branch at the estimated parameters.
    The branches are first separated at the nominal parameters: even inaccurate values show whether a tool is upside
    down, while a fit to both branches would lie between them.
    """
    everything = np.ones(len(q), dtype=np.bool_), None
    # Even the readings of unsensed joints are used: with errors of a degree they still distinguish the branches.
    model = model.with_all_joints_sensed()
    if len(q) * model.equations_per_pose <= len(model.parameters):
        return everything
    keep = ~closure_at_readings(model, nominal_vector(model.parameters), q).flipped
    if 2 * int(keep.sum()) < len(q):
        keep = ~keep
    if bool(keep.all()):
        judged = estimate_paper(model, q)
        if not judged.flipped:
            return keep, judged
        keep[list(judged.flipped)] = False
    part = model.at_poses(np.flatnonzero(keep))
    if int(keep.sum()) * model.equations_per_pose <= len(model.parameters):
        return everything
    paper = estimate_paper(part, q[keep])
    is_kept = ~closure_at_readings(model, paper.x, q).flipped
    return is_kept, paper if np.array_equal(keep, is_kept) else None


def pick_placements(poses: PoseSet, placements: tuple[int, ...]) -> PoseSet:
    """Return the poses of `placements`; raises `ValueError` if one of these placements does not exist."""
    if missing := sorted(set(placements) - set(poses.placements)):
        known = ", ".join(str(p) for p in poses.placements)
        raise ValueError(f"there is no placement {missing[0]}; the file has {known}")
    return poses.at_poses(np.isin(poses.placement, placements))


class FixtureRefusedError(FixtureError):
    """A set-up check refuses this placement; the text states why and what to remount."""

    code = "PARALLEL_AXES"

    def __init__(self, checks: tuple[SetupCheck, ...]) -> None:
        super().__init__("; ".join(f"{c.text}: {c.remedy}" for c in checks))


def refuse_placement(experiment: Experiment, model: ClosureModel) -> None:
    """Raise `FixtureRefusedError` if parameters have no unique values in the nominal placement (Hayati)."""
    part, *_ = model.parts()[0]
    checks = placement_checks(experiment, part, nominal_vector(part.parameters))
    refused = tuple(c for c in checks if c.severity is Severity.REFUSED)
    if refused and model.parameters:
        raise FixtureRefusedError(refused)


def placement_checks(
    experiment: Experiment, model: ClosureModel, x: FloatArray
) -> tuple[SetupCheck, ...]:
    """Check the geometry of every placement at the identified parameters `x` of `model`."""
    by_name: dict[tuple[str, str], SetupCheck] = {}
    for part, columns, _ in model.parts():
        for check in experiment.fixture.placement_checks(experiment.arm, part, x[columns]):
            by_name.setdefault((check.code, check.text), check)
    return tuple(by_name.values())
