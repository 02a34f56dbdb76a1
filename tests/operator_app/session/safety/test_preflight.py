"""Readings are checked against the closure of the loop before enabling, also with an arm known from a placement."""

import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from hardware.arm import Reading
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.prior import KnownArm, known_arm
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import GuardError
from operator_app.session.safety import preflight
from operator_app.session.safety.closure_gate import ClosureFit, LoopAtReading
from operator_app.session.safety.preflight import check_closure_without_poses
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.opening import Choices
from operator_app.session.workflow.remounting import record_in
from operator_app.units import joints_named
from operator_app.virtual_arms import virtual_arm
from solver.chain.poses import PoseSet
from tests.oracles.as_shipped import poses_of
from tests.oracles.journal_events import event_data
from tests.oracles.plant_sessions import opened, take_poses_until
from tests.oracles.shop_floor_remounted import remounted
from tests.oracles.wrong_zero import ShiftedCounterArm, reading_of, with_shifted_zeros

FIXTURES = pytest.mark.parametrize("name", ["hinge", "ball", "rigid"])


@pytest.mark.sample(4)
@FIXTURES
@pytest.mark.parametrize("kind", ["exact", "datasheet", "as_reported", "wild"])
def test_a_sound_arm_is_accepted_in_any_position(name, kind):
    procedure = load_procedure(name)
    for seed in range(2):
        for q in sound_poses(procedure, kind, seed, 4):
            check_closure_without_poses(procedure, reading_of(procedure, q))


@pytest.mark.sample(10)
@FIXTURES
@pytest.mark.parametrize("kind", ["datasheet", "as_reported"])
@pytest.mark.parametrize("zeros", [(1,), (3,), (5,), (1, 4), (2, 3, 5)])
def test_a_sound_arm_with_joints_at_zero_is_accepted(name, kind, zeros):
    """The zero of a counter is a convention: these joints are at zero in this very pose."""
    procedure = load_procedure(name)
    for q in sound_poses(procedure, kind, 1, 3):
        check_closure_without_poses(*zeroed(procedure, q, zeros, q))


class ClosesAsWell:
    """A loop that closes as well with the reading of joint 1, which is zero, as without; apart from rounding."""

    joints = (1,)
    reading_rad = np.zeros(7)

    def fit(self, *ignored_joints: int) -> ClosureFit:
        """Return the closure, a rounding error worse without readings."""
        more = len(ignored_joints)
        return ClosureFit(chi2=1.0 + 1e-12 * more, dof=5 - more, q_rad=np.zeros(7))


def test_a_counter_at_zero_without_effect_is_not_called_reset(monkeypatch):
    """The difference was a negative chi2, of which there is no probability."""
    monkeypatch.setattr(preflight, "LoopAtReading", lambda *_, **__: ClosesAsWell())
    procedure = load_procedure("hinge")
    assert check_closure_without_poses(procedure, reading_of(procedure, np.zeros(7))) > 0.9


@pytest.mark.sample(5)
@FIXTURES
@pytest.mark.parametrize("zeros", [(1,), (3,), (2, 4), (3, 5), (1, 2, 3)])
def test_counter_resets_are_named_in_any_position(name, zeros):
    """By 40 deg each; with a ball, which leaves four freedoms, most are refused without a name."""
    procedure = load_procedure(name)
    refusals = []
    for q in sound_poses(procedure, "datasheet", 1, 4):
        before = q.copy()
        before[[j - 1 for j in zeros]] -= np.deg2rad(40.0)
        refusals.append(refusal(*zeroed(procedure, q, zeros, before)))
    refusals = [text for text in refusals if text]
    assert len(refusals) == 4 or (name == "ball" and len(refusals) >= 2)
    for text in refusals:
        named = re.search(r"counters? of (joints? [\d, and]+) (?:is|are) at zero", text)
        assert {int(j) for j in re.findall(r"\d", named[1])} <= set(zeros)
        assert f"Home {named[1]}" in text
    # Of a hinge, all that were reset are named at some pose.
    assert name != "hinge" or any(joints_named(zeros) in text for text in refusals), refusals


@pytest.mark.parametrize("degrees", [17.0, 22.0, 30.0])
def test_a_counter_reset_near_zero_is_named(degrees):
    """At 17 deg the loop closes with a probability of 1e-2, at 22 deg of 1e-4."""
    procedure = load_procedure("hinge")
    q = procedure.arm.home_rad
    # Iterated, as joint 1 of the nearest closed pose differs.
    for _ in range(20):
        near = q.copy()
        near[0] = np.deg2rad(degrees)
        (q,) = sound_poses(procedure, "datasheet", 1, 1, near=near)
    assert q[0] == pytest.approx(near[0], abs=np.deg2rad(0.1))
    q[0] = 0.0
    with pytest.raises(GuardError, match="counter of joint 1 is at zero") as error:
        check_closure_without_poses(procedure, reading_of(procedure, q))
    assert "really is at zero" in error.value.remedy


def test_joints_with_home_near_zero_are_refused_with_evidence_only():
    """Such joints are often at zero; 30 deg are evidence enough."""
    procedure = load_procedure("rigid")
    (q,) = sound_poses(procedure, "datasheet", 1, 1, near=procedure.arm.home_rad)
    for degrees, message in ((0.0, ""), (8.0, ""), (30.0, "counter of joint 2 is at zero")):
        before = q.copy()
        before[1] -= np.deg2rad(degrees)
        shifted, reading = zeroed(procedure, q, (2,), before)
        home = shifted.arm.home_rad.copy()
        home[1] = 0.0
        text = refusal(replace(shifted, arm=replace(shifted.arm, home_rad=home)), reading)
        assert message in text
        assert bool(message) == bool(text)


def refusal(procedure: Procedure, reading: Reading, known: KnownArm | None = None) -> str:
    """The error by which this reading is refused; empty if it is accepted."""
    try:
        check_closure_without_poses(procedure, reading, known)
    except GuardError as error:
        return str(error)
    return ""


def sound_poses(
    procedure: Procedure, kind: str, seed: int, count: int, *, near: np.ndarray | None = None
) -> list[np.ndarray]:
    """Readings (n,) of closed poses of a drawn arm; up to 20 deg from home, or the nearest to `near`."""
    arm, chosen = procedure.arm, Choices(scenario=kind, seed=seed)
    truth = virtual_arm(arm, procedure.fixture, chosen).true_loop()
    rng = np.random.default_rng(seed)
    poses: list[np.ndarray] = []
    while len(poses) < count:
        away = np.deg2rad(rng.uniform(-20.0, 20.0, arm.joint_count))
        try:
            pose = truth.closed_near(arm.home_rad + away if near is None else near)
        except ValueError:
            if near is not None:
                raise
            continue
        poses.append(pose[1:] - truth.offsets_rad)
    return poses


def zeroed(
    procedure: Procedure, q_rad: np.ndarray, zeros: tuple[int, ...], zero_rad: np.ndarray
) -> tuple[Procedure, Reading]:
    """The arm with its zeros of joints `zeros` at `zero_rad` (n,), and its reading at `q_rad` with them at zero.

    If both are the same, the joints are at zero; else their counters were reset.
    """
    shift, columns = np.zeros(len(q_rad)), [j - 1 for j in zeros]
    shift[columns] = zero_rad[columns]
    read = q_rad - shift
    read[columns] = 0.0
    shifted = with_shifted_zeros(procedure, shift)
    return shifted, reading_of(shifted, read)


def test_a_loop_at_its_nominal_values_has_no_cost():
    procedure = load_procedure("hinge")
    fit = LoopAtReading(procedure, procedure.arm.home_rad).fit()
    assert 0.0 <= fit.chi2 < 1.0
    assert fit.dof == 5
    np.testing.assert_allclose(fit.q_rad, procedure.arm.home_rad, atol=np.deg2rad(3.0))


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


@pytest.mark.sample(1)
@pytest.mark.parametrize("kind", ["stated", "as_reported", "wild"])
def test_known_arm_refuses_steps_and_no_sound_reading(kind):
    refused, refused_by_files = [], []
    for seed in range(2):
        case = remounted(kind, seed, poses=POSES, standings=2)
        known = arm_known_from(poses_of(case.first))
        for q_rad in case.standing:
            assert refusal(HINGE, reading_of(HINGE, q_rad), known) == ""
            for joint in (2, 4):
                shifted = reading_of(HINGE, q_rad + np.deg2rad(30.0) * (np.arange(7) == joint - 1))
                refused.append(refusal(HINGE, shifted, known) != "")
                refused_by_files.append(refusal(HINGE, shifted) != "")
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
