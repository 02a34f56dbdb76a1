"""Sessions on the real plant, without a bus."""

import shutil

import pytest

from operator_app.config.procedure import Procedure
from operator_app.session.workflow.session import Session
from tests.oracles.answers import ends_with
from tests.oracles.journalled_sessions import journalled_sessions
from tests.oracles.live_source import FakeSource
from tests.oracles.opened import opened
from tests.oracles.plant_arm import SERIAL, PlantArm
from tests.oracles.recorded import recorded_folder
from tests.oracles.ticking import Ticking

__all__ = ["ends_with"]


@pytest.fixture
def make_session(tmp_path):
    """Build a session on a fake arm: new in `tmp_path`, or resumed with ``resume=True``, on the same `arm` as well."""
    made: list[Session] = []

    def make(
        procedure: Procedure,
        scenario_name: str = "exact",
        *,
        resume: bool = False,
        serial: str = SERIAL,
        arm: PlantArm | None = None,
        connect: bool = False,
    ) -> Session:
        there = arm or PlantArm(procedure, scenario_name, serial)
        folder = tmp_path / "session"
        made.append(opened(folder, there, procedure, resumed=resume, clock=Ticking()))
        if connect:
            made[-1].connect()
        return made[-1]

    yield make
    for session in made:
        session.close("end of the test")


@pytest.fixture
def source(tmp_path):
    """Sessions on live fake arms; the open one is closed in the end."""
    made = FakeSource(tmp_path / "sessions")
    yield made
    made.close("end of the test")


@pytest.fixture(scope="session")
def journalled(tmp_path_factory):
    """Folders of sessions with a calibration in their journals, by how they were made. Not to be changed."""
    own = tmp_path_factory.mktemp("sessions") / "made"
    shutil.copytree(recorded_folder(journalled_sessions), own)
    return {folder.name: folder for folder in own.iterdir()}
