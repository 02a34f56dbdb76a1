"""A fake arm with a reset or shifted joint counter; counts how often drives are enabled."""

from dataclasses import replace

import numpy as np

from hardware.arm import ArmIdentity, Reading
from hardware.virtual.scenarios import Scenario, scenario
from operator_app.config.procedure import Procedure
from tests.oracles.plant_arm import PlantArm, node


class ShiftedCounterArm(PlantArm):
    """See the module."""

    def __init__(self, procedure: Procedure, chosen: Scenario | None = None) -> None:
        super().__init__(procedure, chosen or scenario("datasheet", seed=3))
        self.serials = {j: 100 + j for j in range(1, 8)}
        self.enabled = 0

    def reset_counter(self, joint: int) -> None:
        self.off_rad[joint - 1] = -self._positions()[joint - 1]

    def connect(self) -> ArmIdentity:
        nodes = tuple(node(j, serial, "drive") for j, serial in self.serials.items())
        return replace(super().connect(), nodes=nodes)

    def take_control(self) -> None:
        self.enabled += 1
        super().take_control()


def with_shifted_zeros(procedure: Procedure, moved_rad: np.ndarray) -> Procedure:
    """The same arm with the zeros of its joints shifted by `moved_rad` (n,)."""
    arm = procedure.arm
    joints = tuple(
        replace(j, lower_rad=j.lower_rad - float(by), upper_rad=j.upper_rad - float(by))
        for j, by in zip(arm.joints, moved_rad, strict=True)
    )
    table = replace(arm.table, theta_off_rad=arm.table.theta_off_rad + moved_rad)
    home = arm.home_rad - moved_rad
    return replace(procedure, arm=replace(arm, joints=joints, table=table, home_rad=home))


def reading_of(procedure: Procedure, q_rad: np.ndarray) -> Reading:
    resolution = np.array([j.sensor.resolution_rad for j in procedure.arm.joints])
    return Reading(
        mean_counts=q_rad / resolution,
        mean_rad=q_rad,
        sd_rad=np.zeros(len(q_rad)),
        samples=8,
        first_sync=1,
    )
