"""The bus of a session is chosen once: the bus that was opened is journalled and resumed."""

import os
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial

import pytest

from hardware.timing import Pace
from operator_app.composition import open_arm, unattended
from operator_app.config.resources import resolve
from operator_app.errors import SessionError
from operator_app.session.store.folders import read_session
from operator_app.session.ui.sessions import Sessions
from operator_app.session.workflow.opening import Choices, Rig, begin, open_session, resume
from tests.oracles.live_arm import FakeSessions
from tests.oracles.plant_arm import PlantArm

CHANNEL = f"test-opening-{os.getpid()}"


@pytest.fixture
def source(tmp_path):
    """The sessions of the terminal app and of plain mode, without options."""
    join = partial(open_arm, pace=Pace.REAL_TIME)
    sessions = Sessions("hinge", Choices(), root=tmp_path / "sessions", join=join)
    yield sessions
    sessions.close("end of the test")


@pytest.fixture
def loopback(monkeypatch):
    """A bus that only the environment names."""
    monkeypatch.setenv("CAN_INTERFACE", "loopback")
    monkeypatch.setenv("CAN_CHANNEL", CHANNEL)
    return monkeypatch


def test_app_journals_and_resumes_the_bus_it_opened(source, loopback):
    runner = source.new()
    folder = runner.session.journal.path.parent
    assert runner.session.state.settings["interface"] == "loopback"
    assert runner.session.state.settings["channel"] == CHANNEL
    assert runner.snapshot().bus == f"loopback {CHANNEL}"
    assert not runner.snapshot().simulated
    runner.session.record("connected", {"serial_number": "SDA-0001"})
    source.close("left")
    assert read_session(folder).state is not None

    loopback.delenv("CAN_INTERFACE")
    loopback.delenv("CAN_CHANNEL")
    resumed = source.resumed(folder.name)
    assert resumed.snapshot().bus == f"loopback {CHANNEL}"
    assert not resumed.snapshot().simulated


def test_run_journals_the_bus_it_opened(tmp_path, loopback, run_command):
    sessions = tmp_path / "sessions"
    with unattended(begin("hinge", Choices(), root=sessions)) as session:
        state = read_session(session.journal.path.parent).state
    assert not sessions.exists()  # an empty session leaves no folder
    assert "no pose was captured" in run_command(3, "run", "hinge", "--sessions", sessions).err
    assert not sessions.exists()
    assert (state.settings["interface"], state.settings["channel"]) == ("loopback", CHANNEL)


def test_virtual_arm_is_journalled_by_scenario_and_seed(source):
    settings = source.new().session.state.settings
    assert (settings["interface"], settings["scenario"], settings["seed"]) == (
        "virtual", "datasheet", 0,
    )  # fmt: skip


def test_sdo_timeout_is_the_procedures(tmp_path):
    opening = begin("hinge", Choices(), root=tmp_path)
    procedure = replace(opening.procedure, bus=replace(opening.procedure.bus, sdo_timeout_s=7.5))
    with open_arm(opening) as default, open_arm(replace(opening, procedure=procedure)) as slow:
        timings = [rig.arm.on_bus.timing for rig in (default, slow)]
    assert [timing.sdo_timeout_s for timing in timings] == [10.0, 7.5]


def test_resumed_session_keeps_its_bus_profile_and_refuses_another(tmp_path):
    own, other = tmp_path / "own.yaml", tmp_path / "other.yaml"
    packaged = resolve("profile", "sarcos").data.decode()
    own.write_text(packaged.replace("name: sarcos", "name: own"))
    other.write_text(packaged.replace("180h + node", "380h + node"))
    opening = begin("hinge", Choices(profile=str(own)), root=tmp_path)
    with open_arm(opening) as rig:
        session = open_session(rig)
        session.close("done")
    own.unlink()  # the journal has a copy
    resumed = resume(str(opening.folder), Choices(), root=tmp_path)
    assert resumed.procedure.profile == opening.procedure.profile
    assert resumed.procedure.profile.name == "own"
    with pytest.raises(SessionError, match=r"other\.yaml differs from it\. Leave --profile out"):
        resume(str(opening.folder), Choices(profile=str(other)), root=tmp_path)


def test_sessions_begun_in_one_second_have_separate_folders(tmp_path):
    """Each name was free when its session was prepared."""
    now = datetime(2026, 11, 23, 8, tzinfo=UTC)
    openings = [begin("hinge", Choices(), root=tmp_path, clock=lambda: now) for _ in range(3)]
    arms = [PlantArm(opening.procedure, "exact") for opening in openings]
    sessions = [
        open_session(Rig(arm=arm, opening=opening, simulated=True))
        for arm, opening in zip(arms, openings, strict=True)
    ]
    names = [session.journal.path.parent.name for session in sessions]
    assert names == [f"20261123-080000-hinge{suffix}" for suffix in ("", "-2", "-3")]
    for session in sessions:
        session.close("done")
        assert read_session(session.journal.path.parent).problem == ""


def test_only_an_unused_session_of_the_named_procedure_is_offered(tmp_path):
    source = FakeSessions(tmp_path / "sessions")
    operations = source.new().operations
    operations.connect()
    operations.set_modes((1, 5))
    for _ in range(2):
        operations.capture(0)
    operations.exclude(1)

    def sessions(procedure):
        return Sessions(procedure, Choices(), root=source.root, join=source._join)

    assert sessions(None).unfinished() is None, "a process uses it"
    source.close("left")
    for named in (None, "hinge"):
        offered = sessions(named).unfinished()
        assert offered is not None
        assert offered.folder == source.last
    assert sessions("ball").unfinished() is None
