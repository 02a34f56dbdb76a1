"""An experiment: measured poses of an arm in a fixture, joints whose readings are not used, and the closed loops."""

from __future__ import annotations

from dataclasses import dataclass, replace

from fixtures.base import EndpointConstraint
from fixtures.measured import Measured
from solver.arrays import BoolArray, IntArray
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.chain.rotations import rotation_matrix
from solver.errors import SolverError
from solver.loops.closure import ClosureModel
from solver.loops.placements import place


class EndpointMissingError(SolverError):
    """The fixture is an instrument, and its measurements are missing or incomplete."""


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
        fixture, poses = self.fixture, self.poses
        model: ClosureModel
        if isinstance(fixture, Measured):
            if poses.endpoint is None or (fixture.full_pose and poses.endpoint.shape[1] < 6):
                columns = "x_m,y_m,z_m" + (",rx_deg,ry_deg,rz_deg" if fixture.full_pose else "")
                raise EndpointMissingError(f"a measured fixture needs the columns {columns}")
            model = fixture.model(self.arm, unsensed_joints=self.unsensed).with_endpoints(
                poses.endpoint[:, :3],
                rotation_matrix(poses.endpoint[:, 3:6]) if fixture.full_pose else None,
            )
        else:
            model = fixture.model(self.arm, unsensed_joints=self.unsensed)
        if len(poses.placements) == 1:
            return model
        return place(model, poses.placement, same_hand=fixture.stays_on_hand)
