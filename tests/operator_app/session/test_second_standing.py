"""Mounted anew, the fixture is somewhere else; the arm is the one that the earlier placement's poses know."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from operator_app.calibration.experiment import Experiment
from operator_app.calibration.prior import KnownArm, known_arm
from operator_app.config.poses_file import parse_poses
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import GuardError
from operator_app.session.safety.preflight import check_closure_without_poses
from operator_app.session.store.journal import read_journal
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.opening import Choices
from operator_app.session.workflow.remounting import record_in
from operator_app.virtual_arms import virtual_arm
from tests.oracles.hearing import take_until
from tests.oracles.opened import opened
from tests.oracles.shop_floor_remounted import Remounted, remounted
from tests.oracles.wrong_zero import WrongZero, reading_of

POSES = 12


def arm_in(procedure: Procedure, placement: int) -> WrongZero:
    """The plant in one placement of its fixture."""
    chosen = Choices(scenario="datasheet", seed=3)
    return WrongZero(procedure, virtual_arm(procedure.arm, procedure.fixture, chosen, placement))


@pytest.fixture(scope="module")
def first_done(tmp_path_factory):
    """A session whose first placement is done, and whose hinge is mounted anew."""
    folder, procedure = tmp_path_factory.mktemp("first") / "session", load_procedure("hinge")
    capture = replace(procedure.capture, poses=POSES, samples_per_pose=8)
    procedure = replace(procedure, placements=2, capture=capture)
    session = opened(folder, arm_in(procedure, 1), procedure)
    session.connect()
    take_poses(session, Listener(), (1, 5))
    session.close("mounted anew")
    record_in(folder, "remounting", 2)
    record_in(folder, "remounted", 2)
    return folder, procedure


@pytest.fixture
def second(first_done, tmp_path, make_session):
    """The same session, its arm in the second placement."""
    folder, procedure = first_done
    shutil.copytree(folder, tmp_path / "session")
    return make_session(procedure, arm=arm_in(procedure, 2), resume=True, connect=True)


@pytest.mark.parametrize(("joint", "degrees"), [(2, 30.0), (3, -30.0), (4, 30.0)])
def test_a_slip_between_two_placements_is_told_before_anything_is_enabled(second, joint, degrees):
    second.arm.off_rad[joint - 1] = np.deg2rad(degrees)
    with pytest.raises(GuardError, match=f"it closes with .*joint {joint} near"):
        take_poses(second, Listener(), (1, 5))
    assert second.arm.enabled == 0


def test_a_sound_arm_goes_on_in_its_second_placement(second):
    take_until(second, POSES + 1)
    assert [p.placement for p in second.state.poses] == [1] * POSES + [2]
    events = read_journal(second.journal.path.parent).events
    told = [e.data["told"] for e in events if e.name == "standing"]
    assert "with the offsets of the earlier placements and within the tolerances" in told[-1]


def _known(case: Remounted) -> KnownArm:
    procedure = load_procedure("hinge")
    poses = parse_poses(case.first.csv().encode(), "first.csv").poses
    found = known_arm(Experiment(arm=procedure.arm, fixture=procedure.fixture.fixture, poses=poses))
    assert found is not None
    return found


def _refused(q_rad: np.ndarray, known: KnownArm | None) -> bool:
    procedure = load_procedure("hinge")
    try:
        check_closure_without_poses(procedure, reading_of(procedure, q_rad), known)
    except GuardError:
        return True
    return False


@pytest.mark.sample(1)
@pytest.mark.parametrize("kind", ["stated", "as_reported", "wild"])
def test_of_the_shop_floors_arms_no_sound_one_is_refused_and_slips_are_found(kind):
    found, by_files, tried = 0, 0, 0
    for seed in range(2):
        case = remounted(kind, seed, poses=POSES, standings=2)
        known = _known(case)
        for q in case.standing:
            assert not _refused(q, known)
            for joint in (2, 4):
                slipped = q.copy()
                slipped[joint - 1] += np.deg2rad(30.0)
                found, tried = found + _refused(slipped, known), tried + 1
                by_files += _refused(slipped, None)
    if kind != "wild":
        assert tried == 8
        assert found >= 7
        assert by_files <= 4


def test_offsets_are_known_as_well_as_it_says():
    pulls = []
    for seed in range(6):
        case = remounted("stated", seed, poses=POSES, standings=1)
        known = _known(case)
        truth = np.array([case.chain.value(name) for name in known.names])
        sd = np.sqrt(np.diag(known.covariance))
        of_offsets = [k for k, name in enumerate(known.names) if name.startswith("theta_off_")]
        assert [known.names[k] for k in of_offsets] == [f"theta_off_{j}" for j in range(2, 7)]
        assert np.all(sd[of_offsets] < np.deg2rad(1.5))
        pulls += (np.abs(known.values - truth) / sd)[of_offsets].tolist()
        assert known.placements == 1
        assert known.placement_ratio == 1.0
    assert np.mean(np.array(pulls) < 2.0) > 0.8


@pytest.mark.campaign
def test_a_hinge_that_stood_far_from_its_files_place_may_do_so_again():
    """Drawn evenly from 40 mm and 15 deg to either side where 30 mm and 10 deg are three sigmas."""
    found = [
        _known(remounted("wild", seed, poses=POSES, standings=1)).placement_ratio
        for seed in range(2)
    ]
    assert 1.5 < np.mean(found) < 4.0


def test_poses_that_fit_badly_tell_less_and_too_few_nothing():
    procedure = load_procedure("hinge")
    case = remounted("stated", 0, poses=POSES, standings=1)
    poses = parse_poses(case.first.csv().encode(), "first.csv").poses
    wrong = poses.q_rad.copy()
    wrong[6:, 2] += np.deg2rad(2.0)
    arm, fixture = procedure.arm, procedure.fixture.fixture
    worse = known_arm(Experiment(arm=arm, fixture=fixture, poses=replace(poses, q_rad=wrong)))
    assert worse is not None
    assert np.all(np.diag(worse.covariance)[:5] > 2.0 * np.diag(_known(case).covariance)[:5])
    two = poses.at_poses(np.arange(2))
    assert known_arm(Experiment(arm=arm, fixture=fixture, poses=two)) is None
