"""Sessions on the simulated plant, without a bus; calibrations by the library."""

import shutil

import pytest
import sarcal

from operator_app.config.procedure import Procedure
from operator_app.session.workflow.session import Session
from tests.oracles.answers import run_command
from tests.oracles.journalled_sessions import journalled_sessions
from tests.oracles.live_arm import FakeSessions
from tests.oracles.panda import FOLDER as PANDA
from tests.oracles.plant_arm import SERIAL, PlantArm
from tests.oracles.plant_sessions import TickingClock, opened
from tests.oracles.recorded import cached_folder

__all__ = ["run_command"]


@pytest.fixture
def make_session(tmp_path):
    """Make sessions on a fake arm: new in `tmp_path`, or resumed with ``resume=True``, also on a given `arm`."""
    sessions: list[Session] = []

    def make(
        procedure: Procedure,
        scenario_name: str = "exact",
        *,
        resume: bool = False,
        serial: str = SERIAL,
        arm: PlantArm | None = None,
        connect: bool = False,
    ) -> Session:
        session_arm = arm or PlantArm(procedure, scenario_name, serial)
        folder = tmp_path / "session"
        sessions.append(
            opened(folder, session_arm, procedure, resumed=resume, clock=TickingClock())
        )
        if connect:
            sessions[-1].connect()
        return sessions[-1]

    yield make
    for session in sessions:
        session.close("end of the test")


@pytest.fixture
def source(tmp_path):
    """Sessions on live fake arms; the open one is closed after the test."""
    source = FakeSessions(tmp_path / "sessions")
    yield source
    source.close("end of the test")


@pytest.fixture(scope="session")
def journalled(tmp_path_factory):
    """Folders of sessions with a journalled calibration, by the name of the way they were made; read-only."""
    folder = tmp_path_factory.mktemp("sessions") / "made"
    shutil.copytree(cached_folder(journalled_sessions), folder)
    return {path.name: path for path in folder.iterdir()}


@pytest.fixture(scope="session")
def result(reference_data):
    """The library's result from exact poses in a hinge."""
    poses = reference_data / "hinge/hinge_exact.csv"
    return sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=poses)


@pytest.fixture(scope="session")
def ball():
    """The library's result from a real arm's poses with a ball in six sockets."""
    poses = PANDA / "panda_1.csv"
    return sarcal.calibrate(
        arm="franka_panda", fixture="ball", poses=poses, drop_unidentifiable=True
    )
