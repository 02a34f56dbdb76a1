"""Sessions on the real plant, without a bus."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from hardware.virtual.scenarios import scenario
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.session.session import Session
from oracles.journalled_sessions import journalled_sessions
from oracles.opened import opened
from oracles.plant_arm import SERIAL, PlantArm


class Ticking:
    """A clock that advances one second a reading."""

    def __init__(self) -> None:
        self._now = datetime(2026, 1, 31, 12, 0, 0, tzinfo=UTC)

    def __call__(self) -> datetime:
        self._now += timedelta(seconds=1)
        return self._now


def exact_procedure(poses: int) -> Procedure:
    """The packaged hinge procedure with fewer poses, for the arm that scenario `exact` carries."""
    procedure = load_procedure("hinge")
    return replace(
        procedure,
        arm=scenario("exact").arm(procedure.arm),
        capture=replace(procedure.capture, poses=poses, samples_per_pose=8),
    )


MakeSession = Callable[..., Session]


@pytest.fixture
def make_session(tmp_path: Path) -> MakeSession:
    """Build a session on a fake arm: new in `tmp_path`, or resumed with ``resume=True``."""

    def make(
        procedure: Procedure,
        scenario_name: str = "exact",
        *,
        resume: bool = False,
        serial: str = SERIAL,
    ) -> Session:
        arm = PlantArm(procedure, scenario_name, serial)
        folder = tmp_path / "session"
        return opened(folder, arm, procedure, resumed=resume, clock=Ticking())

    return make


@pytest.fixture(scope="session")
def journalled(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    """Folders of sessions with a calibration in their journals, by how they were made. Not to be changed."""
    return journalled_sessions(tmp_path_factory.mktemp("sessions"))
