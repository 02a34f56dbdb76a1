"""Consecutive sessions on one controller: each starts where the last one left the arm."""

from pathlib import Path

import numpy as np
import pytest

from hardware.virtual.faults import lose_counts
from operator_app.commands.run import run
from operator_app.errors import GuardError
from operator_app.session.workflow import drive_selection
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from tests.oracles.bench import Bench
from tests.oracles.bench import bench as open_bench

pytestmark = pytest.mark.real_time

OUTSIDE_BOX_DEG = -189.2465 + 12.0
"""Angle of joint 5, 12 deg beyond the procedure's box."""


@pytest.fixture
def bench(tmp_path):
    options = {"procedure": "hinge", "scenario": "datasheet", "seed": 0, "poses": 10}
    with open_bench(tmp_path, **options) as hinge_bench:
        yield hinge_bench


def accepted_folder(bench: Bench) -> Path:
    result = bench.calibrated()
    assert result.solution.accepted, result.solution.reasons
    return result.exported.parameters.parent


def move_joint(session: Session, joint: int, deg: float) -> None:
    """Connect and move one joint, regardless of the procedure's box."""
    session.connect()
    session.set_modes((1, 5))
    result = session.go_to({joint: float(np.deg2rad(deg))}, speed_rad_per_s=0.2)
    assert result.reached, result.reason


@pytest.mark.campaign
def test_ten_runs_agree_and_a_remounted_encoder_is_found(bench, run_command):
    folders = []
    for _ in range(10):
        folders.append(accepted_folder(bench))
        assert bench.verified(folders[-1]).holds
    run_command(0, "compare", folders[0], folders[-1])

    # 2000 counts of joint 3 are 1.8 deg.
    bench.controller.post(lambda: lose_counts(bench.controller.drives[2], -2000))
    comparison = run_command(4, "compare", folders[-1], accepted_folder(bench), "--json").json
    assert comparison["drifted"] == ["theta_off_3"]


@pytest.mark.campaign
def test_arm_outside_box_moves_only_after_consent(bench):
    with bench.session() as session:
        move_joint(session, 5, OUTSIDE_BOX_DEG)
    with bench.session() as session:
        with pytest.raises(GuardError, match=r"joint 5 is at .*, outside") as refused:
            run(session, Listener())
        assert "--go-home" in refused.value.remedy
        assert session.state.poses == ()
        position_deg = np.rad2deg(session.arm.snapshot().positions_rad[4])
        assert abs(position_deg - OUTSIDE_BOX_DEG) < 0.1
    with bench.session(poses=4) as session:
        session.connect()
        assert take_poses(session, Listener(), (1, 5), homing=True) is None
        assert len(session.state.poses) == 4


def test_go_home_reaches_home_and_is_journalled(bench):
    with bench.session() as session:
        move_joint(session, 1, 60.0)
        drive_selection.go_home(session)
        distance_rad = np.abs(session.arm.snapshot().positions_rad - session.model.home_rad)
        # The free joints follow; the true loop closes within a degree of the nominal home.
        assert distance_rad.max() < np.deg2rad(1.0)
        assert distance_rad[[0, 4]].max() < np.deg2rad(0.05)
        assert session.journal.path.read_text().count('"went_home"') == 1


def test_box_and_waypoints_are_relative_to_home(bench):
    with bench.session() as session:
        move_joint(session, 1, 20.0)
        waypoints_away = drive_selection.waypoints_of(session)
        box = drive_selection.drive_box(session)
    with bench.session() as session:
        session.connect()
        session.set_modes((1, 5))
        assert drive_selection.waypoints_of(session) == waypoints_away
        assert session.state.start_rad is not None
        home = session.model.home_rad
        assert np.allclose(box.centre_rad, home[[0, 4]])
        for target in waypoints_away:
            for joint, low, high in ((1, -30.0, 48.0), (5, -70.0, 0.0)):
                assert np.deg2rad(low) <= target[joint] - home[joint - 1] <= np.deg2rad(high)
        beyond = drive_selection.drive_box(session).beyond_rad(home + np.deg2rad(50.0))
        assert beyond.min() > drive_selection.BOX_MARGIN_RAD or beyond[0] == pytest.approx(
            np.deg2rad(2.0)
        )
