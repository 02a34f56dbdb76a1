"""Sessions on the real plant, without a bus."""

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from operator_app.config.procedure import Procedure
from operator_app.session.workflow.session import Session
from tests.oracles.journalled_sessions import journalled_sessions
from tests.oracles.opened import MakeSession, opened
from tests.oracles.plant_arm import SERIAL, PlantArm
from tests.oracles.recorded import recorded_folder
from tests.oracles.ticking import Ticking


@pytest.fixture
def make_session(tmp_path: Path) -> Iterator[MakeSession]:
    """Build a session on a fake arm: new in `tmp_path`, or resumed with ``resume=True``, on the same `arm` as well."""
    made: list[Session] = []

    def make(
        procedure: Procedure,
        scenario_name: str = "exact",
        *,
        resume: bool = False,
        serial: str = SERIAL,
        arm: PlantArm | None = None,
    ) -> Session:
        there = arm or PlantArm(procedure, scenario_name, serial)
        folder = tmp_path / "session"
        made.append(opened(folder, there, procedure, resumed=resume, clock=Ticking()))
        return made[-1]

    yield make
    for session in made:
        session.close("end of the test")


@pytest.fixture(scope="session")
def journalled(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    """Folders of sessions with a calibration in their journals, by how they were made. Not to be changed."""
    own = tmp_path_factory.mktemp("sessions") / "made"
    shutil.copytree(recorded_folder(journalled_sessions), own)
    return {folder.name: folder for folder in own.iterdir()}
