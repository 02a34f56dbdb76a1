"""What a reading is refused for, on an arm that a test brings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from hardware.arm import Reading
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import GuardError
from tests.oracles.opened import MakeSession
from tests.oracles.plant_arm import PlantArm


class Creeping(PlantArm):
    """Joint 3 creeps on, by a tenth of a degree a reading."""

    crept_rad = 0.0

    def settle(self, *, window: int, spread_rad: Sequence[float], timeout_syncs: int) -> bool:
        return False

    def capture(self, samples: int) -> Reading:
        self.crept_rad += np.deg2rad(0.1)
        reading = super().capture(samples)
        return replace(reading, mean_rad=reading.mean_rad + self.crept_rad * (np.arange(7) == 2))


def test_of_an_arm_that_does_not_come_to_rest_joint_spread_and_limit_are_said(
    make_session: MakeSession,
) -> None:
    procedure = load_procedure("hinge")
    session = make_session(procedure, arm=Creeping(procedure, "exact"))
    session.connect()
    with pytest.raises(GuardError) as refused:
        session.read()
    said = refused.value.happened
    window = session.procedure.capture.settle.window_syncs
    spread_deg = 0.1 * (window - 1)
    assert f"joint 3 spreads by {spread_deg:.3f} deg" in said
    limit_rad = session.procedure.capture.settle.spread_rad(session.model)[2]
    assert f"(limit {np.rad2deg(limit_rad):.3f} deg)" in said
