"""The second placement of a fixture: the earlier placement's poses check the arm, the files the placement."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from operator_app.calibration.experiment import Experiment
from operator_app.calibration.prior import KnownArm, known_arm
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import GuardError
from operator_app.session.safety.preflight import check_closure_without_poses
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.opening import Choices
from operator_app.session.workflow.remounting import record_in
from operator_app.virtual_arms import virtual_arm
from solver.chain.poses import PoseSet
from tests.oracles.as_shipped import poses_of
from tests.oracles.journal_events import event_data
from tests.oracles.plant_sessions import opened, take_poses_until
from tests.oracles.shop_floor_remounted import remounted
from tests.oracles.wrong_zero import ShiftedCounterArm, reading_of

POSES = 12
HINGE = load_procedure("hinge")


def arm_in(procedure: Procedure, placement: int) -> ShiftedCounterArm:
    """The plant in one placement of its fixture."""
    choices = Choices(scenario="datasheet", seed=3)
    return ShiftedCounterArm(
        procedure, virtual_arm(procedure.arm, procedure.fixture, choices, placement)
    )


@pytest.fixture(scope="module")
def remounted_session(tmp_path_factory):
    """The folder of a session with a complete first placement, its hinge remounted, and its procedure."""
    folder = tmp_path_factory.mktemp("first") / "session"
    capture = replace(HINGE.capture, poses=POSES, samples_per_pose=8)
    procedure = replace(HINGE, placements=2, capture=capture)
    session = opened(folder, arm_in(procedure, 1), procedure)
    session.connect()
    take_poses(session, Listener(), (1, 5))
    session.close("remounted")
    record_in(folder, "remounting", 2)
    record_in(folder, "remounted", 2)
    return folder, procedure


@pytest.fixture
def second(remounted_session, tmp_path, make_session):
    """The same session resumed, its arm in the second placement."""
    folder, procedure = remounted_session
    shutil.copytree(folder, tmp_path / "session")
    return make_session(procedure, arm=arm_in(procedure, 2), resume=True, connect=True)


@pytest.mark.parametrize(("joint", "degrees"), [(2, 30.0), (3, -30.0), (4, 30.0)])
def test_step_between_placements_is_refused_before_enabling(second, joint, degrees):
    second.arm.off_rad[joint - 1] = np.deg2rad(degrees)
    with pytest.raises(GuardError, match=f"it closes with .*joint {joint} near"):
        take_poses(second, Listener(), (1, 5))
    assert second.arm.enabled == 0


def test_sound_arm_continues_in_the_second_placement(second):
    take_poses_until(second, POSES + 1)
    assert [p.placement for p in second.state.poses] == [1] * POSES + [2]
    message = event_data(second, "standing")[-1]["told"]
    assert "with the offsets of the earlier placements and within the tolerances" in message


def arm_known_from(poses: PoseSet) -> KnownArm:
    experiment = Experiment(arm=HINGE.arm, fixture=HINGE.fixture.fixture, poses=poses)
    known = known_arm(experiment)
    assert known is not None
    return known


def is_refused(q_rad: np.ndarray, known: KnownArm | None) -> bool:
    try:
        check_closure_without_poses(HINGE, reading_of(HINGE, q_rad), known)
    except GuardError:
        return True
    return False


@pytest.mark.sample(1)
@pytest.mark.parametrize("kind", ["stated", "as_reported", "wild"])
def test_known_arm_refuses_steps_and_no_sound_reading(kind):
    refused, refused_by_files = [], []
    for seed in range(2):
        case = remounted(kind, seed, poses=POSES, standings=2)
        known = arm_known_from(poses_of(case.first))
        for q_rad in case.standing:
            assert not is_refused(q_rad, known)
            for joint in (2, 4):
                shifted = q_rad + np.deg2rad(30.0) * (np.arange(7) == joint - 1)
                refused.append(is_refused(shifted, known))
                refused_by_files.append(is_refused(shifted, None))
    if kind != "wild":
        assert len(refused) == 8
        assert sum(refused) >= 7
        assert sum(refused_by_files) <= 4


def test_known_offsets_agree_with_their_uncertainties():
    pulls = []
    for seed in range(6):
        case = remounted("stated", seed, poses=POSES, standings=1)
        known = arm_known_from(poses_of(case.first))
        truth = np.array([case.chain.value(name) for name in known.names])
        sd = np.sqrt(np.diag(known.covariance))
        offsets = [k for k, name in enumerate(known.names) if name.startswith("theta_off_")]
        assert [known.names[k] for k in offsets] == [f"theta_off_{j}" for j in range(2, 7)]
        assert np.all(sd[offsets] < np.deg2rad(1.5))
        pulls += (np.abs(known.values - truth) / sd)[offsets].tolist()
        assert known.placements == 1
        assert known.placement_ratio == 1.0
    assert np.mean(np.array(pulls) < 2.0) > 0.8


@pytest.mark.campaign
def test_placement_far_from_its_file_widens_the_next_placement():
    """Drawn evenly from 40 mm and 15 deg to either side; 30 mm and 10 deg are three sigmas."""
    known_arms = [
        arm_known_from(poses_of(remounted("wild", seed, poses=POSES, standings=1).first))
        for seed in range(2)
    ]
    assert 1.5 < np.mean([known.placement_ratio for known in known_arms]) < 4.0


def test_misfit_widens_the_uncertainties_and_two_poses_tell_nothing():
    poses = poses_of(remounted("stated", 0, poses=POSES, standings=1).first)
    known = arm_known_from(poses)
    q_rad = poses.q_rad.copy()
    q_rad[6:, 2] += np.deg2rad(2.0)
    misfit = arm_known_from(replace(poses, q_rad=q_rad))
    assert np.all(np.diag(misfit.covariance)[:5] > 2.0 * np.diag(known.covariance)[:5])
    two = poses.at_poses(np.arange(2))
    experiment = Experiment(arm=HINGE.arm, fixture=HINGE.fixture.fixture, poses=two)
    assert known_arm(experiment) is None
