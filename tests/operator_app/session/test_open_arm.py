"""A session on the open arm, on the plant without a bus: what the app does, and what goes wrong with a tracker."""

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from fixtures.measured import Measured
from hardware.errors import InstrumentError
from hardware.line_port import CalledLines
from operator_app.errors import GuardError, SessionError
from operator_app.session.ui.operations import Operations
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.drive_selection import visit
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.opening import Choices, Rig, begin, open_session, resume
from operator_app.session.workflow.pose_reading import Instrument
from operator_app.session.workflow.session import Session
from operator_app.virtual_arms import virtual_arm
from tests.oracles.journalled_sessions import Quiet
from tests.oracles.plant_arm import PlantArm

DRIVES = (1, 2, 3, 4, 5, 6, 7)


class Tracked:
    """A session and the tracker that sees its arm; `says` may change what the tracker answers."""

    def __init__(self, root: Path, poses: int = 8, **chosen: object) -> None:
        choices = Choices(poses=poses, scenario="datasheet", seed=1, interface="virtual", **chosen)
        self.opening = replace(begin("open_loop", choices, root=root), folder=root / "session")
        self.says = lambda answer: answer
        self.session = self._opened(self.opening)

    def _opened(self, opening) -> Session:
        procedure = opening.effective_procedure
        fixture = procedure.fixture.fixture
        assert isinstance(fixture, Measured)
        chosen = virtual_arm(procedure.arm, procedure.fixture, opening.choices)
        arm = PlantArm(procedure, chosen)
        tracker = chosen.tracker(arm.plant, fixture)
        port = CalledLines(lambda q: self.says(tracker.answer(q)), "the tracker")
        rig = Rig(
            arm=arm,
            opening=replace(opening, procedure=procedure),
            simulated=True,
            instrument=Instrument(port, full_pose=True, patience_s=0.0),
        )
        return open_session(rig)

    def again(self) -> Session:
        self.session.close("failed")
        folder = self.opening.folder
        self.session = self._opened(resume(str(folder), Choices(), root=folder.parent))
        self.session.connect()
        return self.session


@pytest.fixture
def tracked(tmp_path):
    made = Tracked(tmp_path)
    yield made
    made.session.close("done")


def moved(answer: str, by_m: float) -> str:
    measured = json.loads(answer)
    return json.dumps({**measured, "x_m": measured["x_m"] + by_m})


def test_the_steps_of_the_app_lead_to_an_accepted_and_verified_calibration(tracked):
    session = tracked.session
    quiet = Quiet(session)
    operations = Operations(session, quiet)
    operations.connect()
    operations.check_fixture()
    assert quiet.shown.selected_joints == DRIVES
    assert quiet.shown.forecast.reachable.all()
    operations.set_modes(DRIVES)
    operations.automatic()
    live = quiet.shown.live
    assert live.estimated
    # Of the last pose, by the poses before it.
    assert 0.0 < live.predicted_m[8] < 0.02
    assert live.scaled_condition_number < 100.0
    operations.calibrate("implicit", ())
    solution = quiet.shown.solution
    assert solution.accepted, solution.reasons
    operations.write()
    operations.verify(2)
    assert quiet.shown.verification is not None


def with_one_pose(tracked: Tracked) -> Session:
    session = tracked.session
    session.connect()
    session.set_modes(DRIVES)
    visit(session, 0)
    session.capture(0)
    return tracked.again()


def test_a_displaced_tracker_is_detected_before_the_next_pose(tmp_path):
    tracked = Tracked(tmp_path, poses=5)
    session = with_one_pose(tracked)
    # The same tracker, read again, goes on.
    take_poses(session, Listener(), DRIVES)
    assert [len(r.again.endpoint) for r in session.state.repeats] == [6, 6]
    session.exclude(5, "to go on")
    session = tracked.again()
    tracked.says = lambda answer: moved(answer, 0.003)
    with pytest.raises(GuardError, match="joint's zero, the target or the tracker"):
        take_poses(session, Listener(), DRIVES)
    assert session.state.captured == 5
    session.close("failed")


def test_a_displacement_at_one_pose_is_reported_with_its_size(tracked):
    session = with_one_pose(tracked)
    tracked.says = lambda answer: moved(answer, 0.003)
    with pytest.raises(GuardError, match="or the tracker, has moved by about") as caught:
        take_poses(session, Listener(), DRIVES)
    size = re.search(r"about ([0-9.]+) mm", caught.value.happened)
    assert float(size[1]) == pytest.approx(3.0, abs=0.5)


def test_a_hidden_target_skips_a_waypoint_and_a_silent_tracker_none(tracked):
    session, asked = tracked.session, list[str]()

    def says(answer: str) -> str:
        pose = json.loads(answer)["pose"]
        asked.append(pose)
        if len(asked) == 1:
            return json.dumps({"pose": pose, "lost": "beam broken"})
        return answer if len(asked) == 2 else ""

    tracked.says = says
    session.connect()
    with pytest.raises(InstrumentError, match="no measurement of pose 2 arrived"):
        take_poses(session, Listener(), DRIVES)
    assert asked == ["1", "1", "2"]
    (pose,) = session.state.used_poses
    assert (pose.waypoint, len(pose.endpoint)) == (1, 6)
    assert set(session.state.skipped_waypoints) == {0}


def test_an_arm_that_moves_during_a_measurement_gives_no_pose(tracked):
    session = tracked.session

    def says(answer: str) -> str:
        arm = session.arm
        arm.move({3: float(arm.snapshot().positions_rad[2]) + 0.02}, speed_rad_per_s=0.5)
        return answer

    tracked.says = says
    session.connect()
    session.set_modes(DRIVES)
    with pytest.raises(GuardError, match="joint 3 moved while the tracker measured"):
        session.capture()
    assert session.state.captured == 0


def test_without_a_port_the_remedy_names_the_option(tmp_path):
    opening = begin("open_loop", Choices(interface="virtual"), root=tmp_path)
    procedure = opening.effective_procedure
    chosen = virtual_arm(procedure.arm, procedure.fixture, opening.choices)
    session = open_session(
        Rig(arm=PlantArm(procedure, chosen), opening=opening, simulated=True, instrument=None)
    )
    with pytest.raises(SessionError, match="--tracker tcp:HOST:PORT"):
        session.connect()
    # `export --upload` measures nothing, and has no such option.
    assert session.connect(measuring=False).model == procedure.arm.name
    session.close("failed")
