"""The closed loops of a pose set: fixture, placements and measured endpoints, and selections of poses."""

from __future__ import annotations

import numpy as np

from fixtures.base import EndpointConstraint
from fixtures.measured import Measured
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.chain.rotations import rotation_matrix
from solver.errors import SolverError
from solver.loops.closure import ClosureModel
from solver.loops.placements import place


class EndpointMissingError(SolverError):
    """The fixture is an instrument and the pose set holds no measurements of it, or too little."""


def loop_of_poses(
    arm: ArmModel,
    fixture: EndpointConstraint,
    poses: PoseSet,
    *,
    unsensed_joints: tuple[int, ...] = (),
) -> ClosureModel:
    """Return the loops of all poses, bound to their placements and measurements.

    Raises
    ------
    EndpointMissingError
        The instrument's columns are missing from the pose set.
    """
    model: ClosureModel
    if isinstance(fixture, Measured):
        if poses.endpoint is None or (fixture.full_pose and poses.endpoint.shape[1] < 6):
            columns = "x_m,y_m,z_m" + (",rx_deg,ry_deg,rz_deg" if fixture.full_pose else "")
            raise EndpointMissingError(f"a measured fixture needs the columns {columns}")
        model = fixture.model(arm, unsensed_joints=unsensed_joints).with_endpoints(
            poses.endpoint[:, :3],
            rotation_matrix(poses.endpoint[:, 3:6]) if fixture.full_pose else None,
        )
    else:
        model = fixture.model(arm, unsensed_joints=unsensed_joints)
    if len(poses.placements) == 1:
        return model
    return place(model, poses.placement, same_hand=fixture.stays_on_hand)


def instrument_variance(fixture: EndpointConstraint) -> FloatArray | None:
    """Variance of the endpoint measurement along the closure components (6,), None without one."""
    return fixture.endpoint_variance() if isinstance(fixture, Measured) else None


def pick_placements(poses: PoseSet, placements: tuple[int, ...]) -> PoseSet:
    """Return the poses of some placements; ValueError when one is not there."""
    missing = sorted(set(placements) - set(poses.placements))
    if missing:
        known = ", ".join(str(p) for p in poses.placements)
        raise ValueError(f"there is no placement {missing[0]}; the file has {known}")
    return pick(poses, np.flatnonzero(np.isin(poses.placement, placements)))


def pick(poses: PoseSet, indices: np.ndarray[tuple[int], np.dtype[np.intp]]) -> PoseSet:
    """Return some poses of a set, in the order of `indices`."""
    chosen = indices.tolist()
    return PoseSet(
        placement=poses.placement[indices],
        label=tuple(poses.label[k] for k in chosen),
        q_rad=poses.q_rad[indices],
        sd_rad=None if poses.sd_rad is None else poses.sd_rad[indices],
        samples=None if poses.samples is None else poses.samples[indices],
        endpoint=None if poses.endpoint is None else poses.endpoint[indices],
        utc=None if poses.utc is None else tuple(poses.utc[k] for k in chosen),
        notes=None if poses.notes is None else tuple(poses.notes[k] for k in chosen),
    )


def in_order(model: ClosureModel, other: ClosureModel, x: FloatArray) -> FloatArray:
    """Parameters (P,) of `model`, those that `other` has as in its `x`, the rest nominal."""
    known = {p.name: float(v) for p, v in zip(other.parameters, x, strict=True)}
    return np.array([known.get(p.name, p.nominal) for p in model.parameters])
