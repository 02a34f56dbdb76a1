"""A session that goes on asks whether arm and fixture are the same, before its drives are enabled."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hardware.arm import Reading
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import Cancelled, ConnectAgainError, GuardError
from operator_app.session.safety.preflight import check_closure_without_poses
from operator_app.session.safety.resume_checks import check_counters, counters_near_zero
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.drive_selection import HOMING_SPEED_RAD_PER_S
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from tests.oracles.opened import opened
from tests.oracles.shop_floor import session
from tests.oracles.short_procedure import short_procedure
from tests.oracles.wrong_zero import WrongZero


def left_after(folder: Path, poses: int) -> Procedure:
    """A session of which so many poses were taken."""
    procedure = short_procedure(40, "datasheet", seed=3)
    session = opened(folder, WrongZero(procedure), procedure)
    session.connect()
    session.cancelled = lambda: len(session.state.poses) == poses
    with pytest.raises(Cancelled):
        take_poses(session, Listener(), (1, 5))
    session.close("left")
    return procedure


def resumed(folder: Path, procedure: Procedure, arm: WrongZero) -> Session:
    return opened(folder, arm, procedure, resumed=True)


@pytest.fixture(scope="module")
def half_done(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Procedure]:
    folder = tmp_path_factory.mktemp("half") / "session"
    return folder, left_after(folder, 20)


@pytest.fixture
def left(half_done: tuple[Path, Procedure], tmp_path: Path) -> tuple[Path, Procedure]:
    """A copy of that session of the test's own."""
    folder = tmp_path / "session"
    folder.mkdir()
    (folder / "journal.jsonl").write_bytes((half_done[0] / "journal.jsonl").read_bytes())
    return folder, half_done[1]


def test_the_same_arm_goes_on(left: tuple[Path, Procedure]) -> None:
    folder, procedure = left
    arm = WrongZero(procedure)
    session = resumed(folder, procedure, arm)
    session.connect()
    session.cancelled = lambda: len(session.state.poses) == 22
    with pytest.raises(Cancelled):
        take_poses(session, Listener(), (1, 5))
    assert arm.enabled > 0
    assert len(session.state.poses) == 22
    session.close("done")


@pytest.mark.sample(2)
@pytest.mark.parametrize(("joint", "degrees"), [(1, 5.0), (2, -3.0), (3, 1.5), (4, 0.9)])
def test_a_zero_that_was_moved_is_found_before_a_drive_is_enabled(
    left: tuple[Path, Procedure], joint: int, degrees: float
) -> None:
    folder, procedure = left
    arm = WrongZero(procedure)
    arm.off_rad[joint - 1] = np.deg2rad(degrees)
    session = resumed(folder, procedure, arm)
    session.connect()
    before = len(session.state.poses)
    with pytest.raises(GuardError) as refused:
        take_poses(session, Listener(), (1, 5))
    said = str(refused.value)
    # Before anything is enabled; or, where the loop alone cannot see it, by the pose read again.
    assert "does not close at the present pose" in said or f"joint {joint} has shifted" in said
    if abs(degrees) > 1.0:
        assert arm.enabled == 0
    assert len(session.state.poses) == before
    session.close("failed")


@pytest.mark.sample(2)
@pytest.mark.parametrize(("joint", "degrees"), [(5, 2.0), (6, 2.0), (6, -2.0), (7, 2.0), (7, -2.0)])
def test_two_degrees_of_a_joint_near_the_hand_are_named_before_a_drive_is_enabled(
    left: tuple[Path, Procedure], joint: int, degrees: float
) -> None:
    folder, procedure = left
    arm = WrongZero(procedure)
    arm.off_rad[joint - 1] = np.deg2rad(degrees)
    session = resumed(folder, procedure, arm)
    session.connect()
    with pytest.raises(GuardError, match=f"joint {joint} seems to have shifted by") as refused:
        take_poses(session, Listener(), (1, 5))
    said = refused.value.happened.partition("shifted by ")[2]
    assert float(said.split()[0]) == pytest.approx(degrees, abs=0.3)
    assert arm.enabled == 0
    session.close("failed")


@pytest.mark.parametrize(("counts", "where"), [(0, "at zero"), (36, "near zero")])
def test_a_counter_at_zero_is_named(left: tuple[Path, Procedure], counts: int, where: str) -> None:
    folder, procedure = left
    arm = WrongZero(procedure)
    arm.reads_rad[1] = counts * 2.0 * np.pi / 400_000
    session = resumed(folder, procedure, arm)
    session.connect()
    with pytest.raises(GuardError, match=f"counter of joint 1 is {where}"):
        session.set_modes((1, 5))
    assert arm.enabled == 0
    session.close("failed")


@pytest.mark.parametrize(
    ("counts", "reads"), [(0, r"0\.000"), (36, r"\+0\.032"), (-600, r"-0\.540")]
)
def test_a_counter_near_zero_out_of_range_is_named_in_a_new_session_too(
    tmp_path: Path, counts: int, reads: str
) -> None:
    """The arm sags after its counter began anew, until somebody connects."""
    procedure = short_procedure(6, "datasheet", seed=3)
    arm = WrongZero(procedure)
    arm.reads_rad[2] = counts * 2.0 * np.pi / 400_000
    session = opened(tmp_path / "s", arm, procedure)
    session.connect()
    with pytest.raises(GuardError, match=rf"joint 2 reads {reads} deg, outside its range"):
        session.set_modes((1, 5))
    assert arm.enabled == 0
    session.close("failed")


def test_another_drive_is_named(left: tuple[Path, Procedure]) -> None:
    folder, procedure = left
    arm = WrongZero(procedure)
    arm.serials[3] = 903
    session = resumed(folder, procedure, arm)
    with pytest.raises(GuardError, match=r"node 3 .* serial number 903, it had 103"):
        session.connect()
    assert arm.closed == 1
    session.close("failed")


def test_an_arm_without_nodes_is_refused_and_not_simulated(tmp_path: Path) -> None:
    procedure = short_procedure(6, "datasheet", seed=3)
    arm = WrongZero(procedure)
    arm.serials = {}
    assert not arm.connect().simulated
    session = opened(tmp_path / "s", arm, procedure)
    with pytest.raises(GuardError, match="has no nodes"):
        session.connect()
    assert session.identity is None
    session.close("failed")


class Saying(Listener):
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.heard: list[str] = []

    def report(self, text: str) -> None:
        """Keep it."""
        self.heard.append(text)


@pytest.mark.sample(1)
@pytest.mark.parametrize("joint", [2, 5, 7])
def test_with_few_poses_the_nearest_is_read_again_slowly_and_tells(
    tmp_path: Path, joint: int
) -> None:
    procedure = left_after(tmp_path / "s", 2)
    arm = WrongZero(procedure)
    arm.off_rad[joint - 1] = np.deg2rad(2.0)
    session = resumed(tmp_path / "s", procedure, arm)
    session.connect()
    here, listener = arm.snapshot().positions_rad, Saying()
    away = [np.abs(p.mean_rad - here)[[0, 4]].max() for p in session.state.poses]
    nearest = session.state.poses[int(np.argmin(away))]
    with pytest.raises(GuardError, match=f"pose {nearest.number} differs from its first reading"):
        take_poses(session, listener, (1, 5))
    assert [text for text in listener.heard if f"to pose {nearest.number} at 5 deg/s" in text]
    assert {speed for _, speed in arm.moves} == {HOMING_SPEED_RAD_PER_S}
    assert len(session.state.poses) == 2
    session.close("failed")


SAGGED_DEG = (0.0, 0.0324, 0.25, 1.0, 4.9)


def _moved_zero(procedure: Procedure, joint: int, by_rad: float) -> Procedure:
    """The same arm, that joint counted from elsewhere."""
    arm, column = procedure.arm, joint - 1
    own = arm.joints[column]
    moved = replace(own, lower_rad=own.lower_rad - by_rad, upper_rad=own.upper_rad - by_rad)
    off, home = arm.table.theta_off_rad.copy(), arm.home_rad.copy()
    off[column] += by_rad
    home[column] -= by_rad
    joints = (*arm.joints[:column], moved, *arm.joints[joint:])
    table = replace(arm.table, theta_off_rad=off)
    return replace(procedure, arm=replace(arm, joints=joints, table=table, home_rad=home))


def _standing(
    q_rad: np.ndarray, joint: int, truly_rad: float, reads_rad: float
) -> tuple[Procedure, Reading]:
    """An arm of which a joint is `truly_rad` from where it counts from, and what it reads."""
    procedure = _moved_zero(load_procedure("hinge"), joint, float(q_rad[joint - 1]) - truly_rad)
    read = q_rad.copy()
    read[joint - 1] = reads_rad
    counts = read / np.array([j.sensor.resolution_rad for j in procedure.arm.joints])
    return procedure, Reading(
        mean_counts=counts, mean_rad=read, sd_rad=np.zeros(7), samples=32, first_sync=1
    )


@pytest.mark.sample(5)
@pytest.mark.parametrize("sagged_deg", SAGGED_DEG)
@pytest.mark.parametrize("joint", [1, 2, 3, 4, 5])
def test_it_is_named_wherever_it_has_sagged_to_and_a_joint_that_is_there_is_not(
    joint: int, sagged_deg: float
) -> None:
    """Arms by the shop floor's generator, within what their files state; that joint 60 deg from zero."""
    for seed, side in ((0, -1.0), (1, 1.0)):
        q, near = session(seed, poses=2).readings[0], side * np.deg2rad(sagged_deg)
        check_closure_without_poses(*_standing(q, joint, near, near))
        where = "at zero" if sagged_deg == 0.0 else "near zero"
        with pytest.raises(ConnectAgainError, match=f"joint {joint} is {where}") as refused:
            check_closure_without_poses(*_standing(q, joint, side * np.deg2rad(60.0), near))
        assert f"Home joint {joint}" in str(refused.value)


def test_of_those_near_zero_the_nearest_comes_first() -> None:
    arm = load_procedure("hinge").arm
    q = np.deg2rad([4.0, 0.03, -0.0004, 30.0, 6.0, 0.0, 0.0])
    found = counters_near_zero(arm, q)
    # Joints 6 and 7 have RVDTs, which lose no count.
    assert list(found) == [3, 2, 1]
    assert found[3] == 1.0
    assert found[2] == pytest.approx(0.03 / (2.5 * 360.0 / 400_000))


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
def test_nearer_to_zero_than_to_its_range_a_joint_cannot_be(
    range_deg: tuple[float, float], reads_deg: float, refused: bool
) -> None:
    arm = load_procedure("hinge").arm
    lower, upper = np.deg2rad(range_deg)
    joint = replace(arm.joints[0], lower_rad=float(lower), upper_rad=float(upper))
    arm = replace(arm, joints=(joint, *arm.joints[1:]))
    q = arm.home_rad.copy()
    q[0] = np.deg2rad(reads_deg)
    if refused:
        with pytest.raises(ConnectAgainError, match=r"joint 1 reads .*, outside its range"):
            check_counters(arm, q)
    else:
        check_counters(arm, q)
