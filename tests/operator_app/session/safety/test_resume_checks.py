"""A resumed session checks that arm and fixture are the same before its drives are enabled."""

import shutil
from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from hardware.arm import Reading
from operator_app.calibration.prior import Innovation, ShiftOfReading
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import ConnectAgainError, GuardError
from operator_app.session.safety import resume_checks
from operator_app.session.safety.preflight import check_closure_without_poses
from operator_app.session.safety.resume_checks import check_counters, counters_near_zero
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.drive_selection import HOMING_SPEED_RAD_PER_S
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from tests.oracles.plant_sessions import (
    RecordingListener,
    left_session,
    short_procedure,
    take_poses_until,
)
from tests.oracles.shop_floor import session
from tests.oracles.wrong_zero import ShiftedCounterArm, reading_of, with_shifted_zeros

PROCEDURE = short_procedure(40, "datasheet", seed=3)


@pytest.fixture(scope="module")
def left_after(tmp_path_factory):
    """Folders of sessions that were left after some poses, each made once."""

    @cache
    def make(poses: int) -> Path:
        folder = tmp_path_factory.mktemp("left") / "session"
        return left_session(folder, ShiftedCounterArm(PROCEDURE), PROCEDURE, poses)

    return make


@pytest.fixture
def resumed(left_after, make_session, tmp_path):
    """Resume a copy of such a session with a joint shifted; nothing is connected yet."""

    def make(
        poses: int = 20, joint: int = 1, degrees: float = 0.0
    ) -> tuple[Session, ShiftedCounterArm]:
        shutil.copytree(left_after(poses), tmp_path / "session")
        arm = ShiftedCounterArm(PROCEDURE)
        arm.off_rad[joint - 1] = np.deg2rad(degrees)
        return make_session(PROCEDURE, arm=arm, resume=True), arm

    return make


def test_the_same_arm_is_accepted(resumed):
    session, arm = resumed()
    session.connect()
    take_poses_until(session, 22)
    assert arm.enabled > 0
    assert len(session.state.poses) == 22


@pytest.mark.sample(4)
@pytest.mark.parametrize(
    ("joint", "degrees"),
    [(1, 5.0), (2, -3.0), (3, 1.5), (4, 0.9), (5, 2.0), (6, 2.0), (6, -2.0), (7, 2.0), (7, -2.0)],
)
def test_a_shifted_zero_is_detected_before_enabling(resumed, joint, degrees):
    session, arm = resumed(joint=joint, degrees=degrees)
    session.connect()
    with pytest.raises(GuardError) as error:
        take_poses(session, Listener(), (1, 5))
    text = str(error.value)
    assert len(session.state.poses) == 20
    if joint >= 5:
        # Near the tool, the poses determine the joint and the size.
        assert f"joint {joint} seems to have shifted by" in text
        size = float(text.partition("shifted by ")[2].split()[0])
        assert size == pytest.approx(degrees, abs=0.3)
        # Beyond the tails of the distribution: a limit.
        assert "(probability below 1e-12)" in text
    else:
        # Where the loop alone cannot detect it, the repeated pose does.
        assert "does not close at the present pose" in text or f"joint {joint} has shifted" in text
    if abs(degrees) > 1.0:
        assert arm.enabled == 0


@pytest.mark.parametrize(("counts", "where"), [(0, "at zero"), (36, "near zero")])
def test_a_counter_at_zero_after_a_resume_is_named(resumed, counts, where):
    session, arm = resumed()
    arm.reads_rad[1] = counts * 2.0 * np.pi / 400_000
    session.connect()
    with pytest.raises(GuardError, match=f"counter of joint 1 is {where}"):
        session.set_modes((1, 5))
    assert arm.enabled == 0


def test_a_nan_misfit_is_no_agreement(resumed, monkeypatch):
    session, arm = resumed()
    shift = ShiftOfReading(size_rad=np.nan, sigma_rad=np.nan, explains=np.nan)
    unknown = Innovation(chi2=np.nan, dof=5, usual=1.0, shifts={5: shift})
    monkeypatch.setattr(resume_checks, "innovation", lambda *_: unknown)
    session.connect()
    with pytest.raises(GuardError, match="does not close at the present pose"):
        session.set_modes((1, 5))
    assert arm.enabled == 0


def test_a_replaced_drive_is_named(resumed):
    session, arm = resumed()
    arm.serials[3] = 903
    with pytest.raises(GuardError, match=r"node 3 .* serial number 903, it had 103"):
        session.connect()
    assert arm.closed == 1


def test_an_arm_without_nodes_is_refused_unless_simulated(make_session):
    arm = ShiftedCounterArm(PROCEDURE)
    arm.serials = {}
    assert not arm.connect().simulated
    session = make_session(PROCEDURE, arm=arm)
    with pytest.raises(GuardError, match="has no nodes"):
        session.connect()
    assert session.identity is None


@pytest.mark.sample(1)
@pytest.mark.parametrize("joint", [2, 5, 7])
def test_with_few_poses_the_nearest_is_measured_again(resumed, joint):
    session, arm = resumed(2, joint, 2.0)
    session.connect()
    q_rad, listener = arm.snapshot().positions_rad, RecordingListener()
    away = [np.abs(p.mean_rad - q_rad)[[0, 4]].max() for p in session.state.poses]
    nearest = session.state.poses[int(np.argmin(away))]
    with pytest.raises(GuardError, match=f"pose {nearest.number} differs from its first reading"):
        take_poses(session, listener, (1, 5))
    assert [text for text in listener.reports if f"to pose {nearest.number} at 5 deg/s" in text]
    assert {speed for _, speed in arm.moves} == {HOMING_SPEED_RAD_PER_S}
    assert len(session.state.poses) == 2


def at_reading(
    q_rad: np.ndarray, joint: int, true_rad: float, read_rad: float
) -> tuple[Procedure, Reading]:
    """An arm with a joint `true_rad` from its zero, and its reading with that joint at `read_rad`."""
    shift, read = np.zeros(len(q_rad)), q_rad.copy()
    shift[joint - 1] = q_rad[joint - 1] - true_rad
    read[joint - 1] = read_rad
    procedure = with_shifted_zeros(load_procedure("hinge"), shift)
    return procedure, reading_of(procedure, read)


@pytest.mark.sample(5)
@pytest.mark.parametrize("sagged_deg", [0.0, 0.0324, 0.25, 1.0, 4.9])
@pytest.mark.parametrize("joint", [1, 2, 3, 4, 5])
def test_a_reset_joint_is_named_despite_sag_and_others_are_not(joint, sagged_deg):
    """Arms by the shop floor's generator, within what their files state; that joint 60 deg from zero."""
    for seed, side in ((0, -1.0), (1, 1.0)):
        q, near = session(seed, poses=2).readings[0], side * np.deg2rad(sagged_deg)
        check_closure_without_poses(*at_reading(q, joint, near, near))
        where = "at zero" if sagged_deg == 0.0 else "near zero"
        with pytest.raises(ConnectAgainError, match=f"joint {joint} is {where}") as error:
            check_closure_without_poses(*at_reading(q, joint, side * np.deg2rad(60.0), near))
        assert f"Home joint {joint}" in str(error.value)


def test_of_several_joints_near_zero_the_nearest_comes_first():
    arm = load_procedure("hinge").arm
    q = np.deg2rad([4.0, 0.03, -0.0004, 30.0, 6.0, 0.0, 0.0])
    counters = counters_near_zero(arm, q)
    # Joints 6 and 7 have RVDTs, which lose no count.
    assert list(counters) == [3, 2, 1]
    assert counters[3] == 1.0
    assert counters[2] == pytest.approx(0.03 / (2.5 * 360.0 / 400_000))


@pytest.mark.parametrize(
    ("range_deg", "reads_deg", "refused"),
    [
        ((0.0, 150.0), 0.0, False),
        ((-1e-6, 150.0), 0.0, False),
        ((170.0, 320.0), 0.0324, True),
        ((170.0, 320.0), -4.9, True),
        # On its stop, a little outside what its file says.
        ((1.5, 150.0), 1.0, False),
        ((1.5, 150.0), 0.5, True),
        # Wrong, but not near zero: the loop is asked.
        ((170.0, 320.0), 30.0, False),
    ],
)
def test_a_joint_nearer_to_zero_than_to_its_range_was_reset(range_deg, reads_deg, refused):
    arm = load_procedure("hinge").arm
    first, *others = arm.joints
    lower, upper = np.deg2rad(range_deg)
    arm = replace(arm, joints=(replace(first, lower_rad=lower, upper_rad=upper), *others))
    q = arm.home_rad.copy()
    q[0] = np.deg2rad(reads_deg)
    refusal = pytest.raises(ConnectAgainError, match=r"joint 1 reads .*, outside its range")
    with refusal if refused else nullcontext():
        check_counters(arm, q)
