"""Selects the drive joints by the rankings of `solver.design` and by trials on the arm, and states the reasons."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from operator_app.errors import GuardError, SessionError
from operator_app.planning.task import margin_rad, ranges_of
from operator_app.units import joints_named
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.design.drive_joints import (
    DriveTrial,
    RankedDrives,
    rank_at_pose,
    rank_by_trial,
    rank_over_region,
)
from solver.design.manifold import Manifold, candidate_poses
from solver.design.motion import LIMITS
from solver.design.paths import PathGraph
from solver.loops.closure import ClosureModel

REGION_POSES = 700
"""Number of poses sampled over the reachable region; enough to rank pairs of joints."""
TRIED_SETS = 4
"""Number of drive sets tried on the arm."""
MOST_SETS = 3
"""Largest number of drive sets of a plan."""
INEXACT_RAD = float(np.deg2rad(0.5))
FEWEST_WAYPOINTS = 10
"""Drive joints are chosen only if the reachable region has at least this many poses."""
WORTH_A_CHANGE = 0.03
"""A plan gets a further drive set only if the set adds at least this share of the reachable region."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivePrediction:
    """Drive sets ranked by the model.

    `here`, `region`: sets ranked at the current pose and over the reachable region, the best first.
    `inexact`: joints with a linearity deviation above `INEXACT_RAD`. They become drives only if no other set is usable.
    """

    here: tuple[RankedDrives, ...]
    region: tuple[RankedDrives, ...]
    manifold: Manifold
    inexact: frozenset[int] = frozenset()


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveChoice:
    """The chosen drive joints.

    `sets`: all drive sets that a plan may use: first `drives`, then sets that reach other poses.
    `prediction`: rankings by the model. `trial`: ranking by trials on the arm; () if there were no trials.
    """

    drives: tuple[int, ...]
    sets: tuple[tuple[int, ...], ...]
    reasons: tuple[str, ...]
    prediction: DrivePrediction
    trial: tuple[RankedDrives, ...] = ()

    @property
    def ranked(self) -> tuple[RankedDrives, ...]:
        """The drive sets ranked over the reachable region, with the chosen set moved to the front."""
        region = self.prediction.region
        return tuple(sorted(region, key=lambda r: r.drives != self.drives))


def predict_drives(
    arm: ArmModel, model: ClosureModel, x: FloatArray, q_rad: FloatArray, *, seed: int = 0
) -> DrivePrediction:
    """Rank all drive sets at the pose `q_rad` (n,) and over the region reachable from it, for parameters `x` (P,).

    Raises `SessionError` if the loop does not close near this pose, or the arm has too little room there.
    """
    try:
        ranges = ranges_of(arm).within(margin_rad(arm))
        manifold = candidate_poses(model, x, q_rad, ranges, count=REGION_POSES, seed=seed)
        prediction = DrivePrediction(
            here=rank_at_pose(model, x, q_rad),
            region=rank_over_region(manifold),
            manifold=manifold,
            inexact=frozenset((1 + np.flatnonzero(arm.linearity_rad() > INEXACT_RAD)).tolist()),
        )
    except ValueError as error:
        singular = isinstance(error, np.linalg.LinAlgError)
        reason = "the arm's present pose is singular, e.g. stretched out" if singular else error
        raise SessionError(
            f"drive joints cannot be ranked: {reason}",
            "check the arm's position and the fixture's measured values, or name the joints: "
            "modes: {position: [1, 5]}",
        ) from error
    if manifold.size < FEWEST_WAYPOINTS:
        raise SessionError(
            f"the arm has too little room around its present pose{_joint_out_of_range(arm, manifold)}",
            "start from a pose nearer the middle of the ranges, or correct the fixture's measured values",
        )
    return prediction


def usable_sets(
    prediction: DrivePrediction, unsensed_joints: tuple[int, ...] = ()
) -> list[RankedDrives]:
    """Return the sets usable at the pose and over the region, best first; with inexact joints only as a last resort."""
    usable_now = {r.drives for r in prediction.here if r.usable}
    usable = [
        r
        for r in prediction.region
        if r.usable and r.drives in usable_now and not set(r.drives) & set(unsensed_joints)
    ]
    return [r for r in usable if not set(r.drives) & prediction.inexact] or usable


def choose_drives(
    prediction: DrivePrediction,
    *,
    unsensed_joints: tuple[int, ...] = (),
    trials: Sequence[DriveTrial] = (),
) -> DriveChoice:
    """Return the best usable drive set, with reasons.

    A usable set can drive the chain at the current pose and over the reachable region. Without trials, the best set has
    the highest score over this region. With trials, the best of the tried sets has the highest product of this score
    and the score of the trials. Raises `SessionError` if no set is usable, or none of the tried sets moves the arm.
    """
    usable = usable_sets(prediction, unsensed_joints)
    if not usable:
        near = prediction.here[0]
        raise SessionError(
            f"no joints can drive the chain from the present pose: with {joints_named(near.drives)}, "
            f"{near.reasons[0]}",
            "move the arm away from the singularity by hand, or mount the hinge elsewhere "
            "(`sarcal plan --advise`)",
        )
    best, reasons, trial = usable[0], usable[0].reasons, rank_by_trial(trials)
    if trials:
        measured = {r.drives: r for r in trial if r.usable}
        tried = [r for r in usable if r.drives in measured]
        if not tried:
            raise SessionError(
                f"none of the {len(trials)} sets of joints that were tried drives the arm: "
                f"with {joints_named(trial[0].drives)}, {trial[0].reasons[0]}",
                "check what holds the arm, or name the joints: modes: {position: [1, 5]}",
            )
        best = max(tried, key=lambda r: r.score * measured[r.drives].score)
        reasons = (*best.reasons, f"on the arm: {measured[best.drives].reasons[-1]}")
    return DriveChoice(
        drives=best.drives,
        sets=_with_complementary_sets(prediction.manifold, best.drives, [r.drives for r in usable]),
        reasons=reasons,
        prediction=prediction,
        trial=trial,
    )


def best_or_named_drives(
    prediction: DrivePrediction,
    drives: tuple[int, ...] | None,
    *,
    kind: str,
    unsensed_joints: tuple[int, ...],
) -> DriveChoice:
    """Return the drive set that the procedure names or, if `drives` is None, the best usable set (`choose_drives`).

    `kind`: kind of the fixture, for error texts. Raises `GuardError` for an unknown joint or a wrong number of joints.
    """
    if drives is None:
        return choose_drives(prediction, unsensed_joints=unsensed_joints)
    motion = prediction.manifold.motion
    problem = modes_problem(
        drives, joint_count=motion.joint_count, mobility=motion.degrees, kind=kind
    )
    if problem is not None:
        raise problem
    drives = tuple(sorted(drives))
    of_it = next((r.reasons for r in prediction.region if r.drives == drives), ())
    return DriveChoice(
        drives=drives,
        sets=(drives,),
        reasons=("named by the procedure", *of_it),
        prediction=prediction,
    )


def _joint_out_of_range(arm: ArmModel, manifold: Manifold) -> str:
    over = np.maximum(arm.lower_rad - manifold.q[0], manifold.q[0] - arm.upper_rad)
    joint = int(np.argmax(over))
    if over[joint] <= 0.0:
        return ": every path soon reaches the end of a joint's range"
    return (
        f": with the fixture's measured values, the nearest pose that closes the loop has joint {joint + 1} "
        f"{np.rad2deg(over[joint]):.0f} deg beyond its range"
    )


def _with_complementary_sets(
    manifold: Manifold, drives: tuple[int, ...], usable: list[tuple[int, ...]]
) -> tuple[tuple[int, ...], ...]:
    def reach(*sets: tuple[int, ...]) -> float:
        return float(PathGraph(manifold, sets, LIMITS).reachable(0).mean())

    chosen = [drives]
    # A set that reaches few poses alone adds few poses: the first six sets are enough.
    others = [d for d in usable if d != drives][:6]
    while others and len(chosen) < MOST_SETS:
        share = [reach(*chosen, d) for d in others]
        best = int(np.argmax(share))
        if share[best] < reach(*chosen) + WORTH_A_CHANGE:
            break
        chosen.append(others.pop(best))
    return tuple(chosen)


def modes_problem(
    position_joints: tuple[int, ...], *, joint_count: int, mobility: int, kind: str
) -> GuardError | None:
    """Return the error for a wrong set of joints in position mode; None if the set is valid."""
    have = len(set(position_joints))
    if wrong := [j for j in position_joints if not 1 <= j <= joint_count]:
        return GuardError(
            f"there is no joint {wrong[0]}", f"joints are numbered 1 to {joint_count}"
        )
    if have == mobility:
        return None
    which = joints_named(sorted(set(position_joints))) if have else "no joint"
    fact = (
        f"{which} {'are' if have > 1 else 'is'} in position mode, but "
        + ("an open arm leaves" if mobility == joint_count else f"a {kind} fixture leaves")
        + f" the arm {mobility} degree{'s' if mobility != 1 else ''} of freedom"
    )
    consequence = (
        "nothing would hold the other joints, and the arm would sag"
        if have < mobility
        else "they would work against each other through the fixture, and torque would build up "
        "until a drive trips"
    )
    return GuardError(f"{fact}: {consequence}", f"put exactly {mobility} in position mode")
