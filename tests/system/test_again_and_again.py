"""Session after session on one controller: the arm stands wherever the last one left it, and the next works."""

from pathlib import Path

import numpy as np
import pytest

from hardware.virtual.faults import lose_counts
from operator_app.errors import GuardError
from operator_app.headless.procedure_run import run
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.drive_selection import (
    BOX_MARGIN_RAD,
    drive_box,
    go_home,
    waypoints_of,
)
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from tests.oracles.bench import Bench
from tests.oracles.bench import bench as running

pytestmark = pytest.mark.real_time


@pytest.fixture
def bench(tmp_path):
    with running(tmp_path, procedure="hinge", scenario="datasheet", seed=0, poses=10) as found:
        yield found


def calibrated(bench: Bench) -> Path:
    result = bench.calibrated()
    assert result.solution.accepted, result.solution.reasons
    assert result.exported is not None
    return result.exported.folder


@pytest.mark.campaign
def test_ten_runs_and_verifications_on_one_controller_are_accepted_and_agree(bench, ends_with):
    folders = []
    for _ in range(10):
        folders.append(calibrated(bench))
        assert bench.verified(folders[-1]).holds
    ends_with(0, "compare", folders[0], folders[-1])

    # Somebody remounts the encoder of joint 3: 2000 counts are 1.8 deg.
    bench.controller.post(lambda: lose_counts(bench.controller, 3, -2000))
    after = calibrated(bench)
    found = ends_with(4, "compare", folders[-1], after, "--json").json
    assert found["drifted"] == ["theta_off_3"]


def taken_to(session: Session, joint: int, deg: float) -> None:
    """Drive one joint elsewhere, as a person does who does not heed the procedure's box."""
    session.connect()
    session.set_modes((1, 5))
    moved = session.go_to({joint: float(np.deg2rad(deg))}, speed_rad_per_s=0.2)
    assert moved.reached, moved.reason


@pytest.mark.campaign
def test_an_arm_outside_its_box_is_not_moved_before_the_operator_agrees(bench):
    with bench.session() as session:
        taken_to(session, 5, -189.2465 + 12.0)
    with bench.session() as session:
        with pytest.raises(GuardError, match=r"joint 5 is at .*, outside") as refused:
            run(session, Listener())
        assert "--go-home" in refused.value.remedy
        assert session.state.poses == ()
        here = session.arm.snapshot().positions_rad
        assert abs(np.rad2deg(here[4]) - (-189.2465 + 12.0)) < 0.1
    with bench.session(poses=4) as session:
        session.connect()
        end = take_poses(session, Listener(), (1, 5), homing=True)
        assert end is None
        assert len(session.state.poses) == 4


def test_home_is_home_and_recorded(bench):
    with bench.session() as session:
        taken_to(session, 1, 60.0)
        go_home(session)
        away = session.arm.snapshot().positions_rad - session.model.home_rad
        # The free joints follow; the paper's arm closes within a degree of its home.
        assert np.abs(away).max() < np.deg2rad(1.0)
        assert np.abs(away[[0, 4]]).max() < np.deg2rad(0.05)
        assert session.journal.path.read_text().count('"went_home"') == 1


def test_boxes_count_from_home_wherever_the_arm_stands(bench):
    with bench.session() as session:
        taken_to(session, 1, 20.0)
        from_afar = waypoints_of(session)
        box = drive_box(session)
    with bench.session() as session:
        session.connect()
        session.set_modes((1, 5))
        assert waypoints_of(session) == from_afar
        assert session.state.start_rad is not None
        home = session.model.home_rad
        assert np.allclose(box.centre_rad, home[[0, 4]])
        for target in from_afar:
            for joint, low, high in ((1, -30.0, 48.0), (5, -70.0, 0.0)):
                assert np.deg2rad(low) <= target[joint] - home[joint - 1] <= np.deg2rad(high)
        beyond = drive_box(session).beyond_rad(home + np.deg2rad(50.0))
        assert beyond.min() > BOX_MARGIN_RAD or beyond[0] == pytest.approx(np.deg2rad(2.0))
