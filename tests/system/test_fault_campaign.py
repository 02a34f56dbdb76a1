"""Every fault that the virtual controller can make, in every phase: what is said, and that no accepted pose is wrong.

The rows of `hardware.virtual.fault_messages` are the documentation of each fault; the campaign holds the program
to them. All of them in every phase: pytest -m campaign tests/system/test_fault_campaign.py.
"""

import itertools
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from hardware.arm import DriveState, JointMode
from hardware.buses.python_can import BusSettings
from hardware.control.canopen_arm import CanopenArm
from hardware.errors import HardwareError
from hardware.virtual.fault_messages import FAULTS, ArmReaction
from hardware.virtual.faults import FAULT_KINDS, inject
from hardware.virtual.scenarios import scenario
from operator_app.config.parameters_file import format_parameters
from operator_app.config.procedure_file import load_procedure
from operator_app.session.store.journal import read_journal
from operator_app.session.store.replay import replay
from operator_app.session.workflow.opening import Choices
from operator_app.virtual_arms import run_controller
from tests.oracles.fast_arm import fast_arm
from tests.oracles.fault_session import CLOSES, PATIENCE_S, Outcome, loop_error, session_with
from tests.oracles.parameter_documents import VALUES, make_document

BEFORE, FIRST_SYNCS, IN_CAPTURE = 0, 30, (450, 640, 700)
"""When it happens: before anybody connects, as the drives are enabled, and among the poses."""

JOINT = {"stray": 5, "sagging-drive": 5, "deaf-drive": 5}
"""Whose fault it is, where it is not joint 4's: only a joint that is commanded can diverge."""

AT_CONNECT = {kind for kind, words in FAULTS.items() if words.at_connect}
"""What is read as the arm is connected, and has to be told then."""

STANDS_DEG = 0.05
"""How far a joint may go once its fault has been told: what servo and fixture give."""

LAGS_DEG = 0.5
"""The same of a joint on its way that nothing reaches any more, or that a late target reaches: what its servo lags
behind at full speed."""

HOLDS = DriveState.QUICK_STOP_ACTIVE, JointMode.POSITION

SLIP_M = 1e-3

OFF_RAD = {
    "lost-counts-5": 5 * 2.0 * np.pi / 400_000,
    "lost-counts-500": 500 * 2.0 * np.pi / 400_000,
    "sensor-jump": -np.deg2rad(2.0),
}
"""By how much a sensor's zero is elsewhere afterwards, true angle less reading."""

QUICK = {
    ("collision", IN_CAPTURE[1]),
    ("frozen-sensor", IN_CAPTURE[0]),
    ("unwatched", BEFORE),
    ("deaf-drive", BEFORE),
}
"""Those of the default run."""


def judge(kind: str, at_sync: int, folder: Path) -> Outcome:
    """Hold what came of a session with this fault to its row; return it."""
    joint, words = JOINT.get(kind, 4), FAULTS[kind]
    found = session_with(kind, folder, joint=joint, at_sync=at_sync)
    if found.said:
        told = [part.format(joint=joint).lower() for part in words.texts]
        assert any(part in found.said.lower() for part in told), found.said
    else:
        assert words.goes_on
        assert not (kind in AT_CONNECT and at_sync == BEFORE)
        assert not (kind in ("lost-enable", "bus-off") and at_sync != BEFORE)
        assert kind != "deaf-drive"
        assert len(found.poses) == 6
    off_rad = np.zeros(7)
    if at_sync in (BEFORE, FIRST_SYNCS) and not found.said:
        # A zero that was elsewhere for all poses is what a calibration is for.
        off_rad[joint - 1] = OFF_RAD.get(kind, 0.0)
    errors = [loop_error(pose.mean_rad + off_rad) for pose in found.poses]
    # A fixture that has slipped holds the hand elsewhere: the readings are right, by that much.
    closes = CLOSES + (SLIP_M if kind == "slipped-fixture" else 0.0)
    assert all(error < closes for error in errors), (found.said, errors)
    judge_arm(found, words.arm, connected=at_sync != BEFORE)
    kept = replay(read_journal(folder).events).used_poses
    assert [pose.number for pose in kept] == [pose.number for pose in found.poses]
    assert all(
        np.array_equal(a.mean_rad, b.mean_rad) for a, b in zip(kept, found.poses, strict=True)
    )
    return found


def judge_arm(found: Outcome, arm: ArmReaction, *, connected: bool) -> None:
    """Hold what drives and plant did to the row: once a fault is told, nothing goes on."""
    assert JointMode.FREE not in found.ended, found.ended
    if not found.said:
        return
    lags = arm in (ArmReaction.UNHEARD, ArmReaction.LATE)
    goes_deg = LAGS_DEG if lags else STANDS_DEG
    assert found.moved_deg < goes_deg, found.moved_deg
    states = [state for state, _ in found.then]
    if not connected and DriveState.OPERATION_ENABLED not in states and len({*states}) == 1:
        return  # nothing was enabled yet
    match arm:
        case ArmReaction.HOLDS:
            assert {mode for _, mode in found.then} <= {JointMode.POSITION, None}
            assert DriveState.OPERATION_ENABLED not in states
        case ArmReaction.TRIPS if "tripped" in found.said:
            assert DriveState.OPERATION_ENABLED not in states
            assert {*states} & {DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE}
            assert JointMode.FREE not in {mode for _, mode in found.then}
        case ArmReaction.STOPPED if "the arm has been stopped" in found.said:
            # Its own power is gone, at once and for good; to be stopped it would only have held its error.
            off = DriveState.SWITCH_ON_DISABLED, None
            assert sorted(map(str, found.then)) == sorted(map(str, [HOLDS] * 6 + [off]))
            assert sorted(map(str, found.ended)) == sorted(map(str, [HOLDS[1]] * 6 + [None]))
        case ArmReaction.BLOCKS if "heartbeat" not in found.said:
            assert {mode for _, mode in found.then} == {None}


@pytest.mark.campaign
@pytest.mark.parametrize("joint", [1, 5])
def test_a_sensor_that_stands_still_in_a_joint_that_is_led_leaves_no_wrong_pose(tmp_path, joint):
    """Within a degree of its target nobody misses it there; on the next way it does not follow."""
    found = session_with("frozen-sensor", tmp_path / "s", joint=joint, at_sync=IN_CAPTURE[0])
    assert any(part in found.said for part in FAULTS["frozen-sensor"].texts), found.said
    assert found.wrong == ()
    assert len(found.poses) == 2


LED = [
    pytest.param("lost-counts-500", 5, 640),
    pytest.param("lost-counts-500", 5, 700, marks=pytest.mark.campaign),
    pytest.param("lost-counts-500", 1, 450, marks=pytest.mark.campaign),
    pytest.param("sensor-jump", 5, 640, marks=pytest.mark.campaign),
    pytest.param("sensor-jump", 1, 450, marks=pytest.mark.campaign),
]


@pytest.mark.campaign
@pytest.mark.parametrize(("kind", "joint", "at_sync"), LED)
def test_a_slip_in_a_joint_that_is_led_is_told_when_the_first_pose_is_read_again(
    tmp_path, kind, joint, at_sync
):
    """Its drive makes up for it at once: all joints move, and nothing jumps alone. No pose before it is wrong."""
    found = session_with(kind, tmp_path / "s", joint=joint, at_sync=at_sync)
    ended_sync = {
        event.data["number"]: event.data["first_sync"] + event.data["samples"]
        for event in read_journal(tmp_path / "s").events
        if event.name == "pose"
    }
    wrong = found.wrong
    if found.said:
        assert any(part.format(joint=joint) in found.said for part in FAULTS[kind].texts), (
            found.said
        )
        assert not wrong
        return
    assert any(f"joint {joint} has shifted by" in text for text in found.told), found.told
    assert all(ended_sync[number] >= at_sync for number in wrong)


def test_every_fault_has_its_row():
    assert list(FAULTS) == list(FAULT_KINDS)
    for words in FAULTS.values():
        assert words.goes_on or words.texts


def test_without_a_fault_every_pose_is_right(tmp_path):
    found = session_with("", tmp_path / "s", joint=4, at_sync=0)
    assert (found.said, len(found.poses), found.wrong) == ("", 6, ())
    assert not any("differs from its first reading" in text for text in found.told)


@pytest.mark.campaign
def test_a_wall_clock_that_is_set_back_and_forth_costs_no_pose(tmp_path):
    """Poses count in the order in which they were taken; nothing is measured by the wall clock."""
    told = itertools.cycle([timedelta(0), timedelta(hours=-1), timedelta(days=400), timedelta(0)])

    def clock() -> datetime:
        return datetime(2026, 3, 29, 2, 30, tzinfo=UTC) + next(told)

    found = session_with("", tmp_path / "s", joint=4, at_sync=0, clock=clock)
    assert (found.said, found.wrong) == ("", ())
    assert [pose.number for pose in found.poses] == [1, 2, 3, 4, 5, 6]
    stamps = [pose.utc for pose in found.poses]
    assert stamps != sorted(stamps)
    events = read_journal(tmp_path / "s").events
    kept = replay(events).used_poses
    assert [pose.number for pose in kept] == [1, 2, 3, 4, 5, 6]
    assert np.array_equal([p.mean_rad for p in kept], [p.mean_rad for p in found.poses])


@pytest.mark.campaign
def test_the_oracle_sees_what_a_slip_of_half_a_degree_does(tmp_path):
    found = session_with("", tmp_path / "s", joint=4, at_sync=0, poses=3)
    q = found.poses[-1].mean_rad.copy()
    assert loop_error(q) < 3e-5
    for joint in range(7):
        off = q.copy()
        off[joint] += np.deg2rad(0.5)
        assert loop_error(off) > 1e-3


@pytest.mark.parametrize(
    ("kind", "at_sync"),
    [
        pytest.param(*case, marks=() if case in QUICK else pytest.mark.campaign)
        for case in itertools.product(FAULT_KINDS, (BEFORE, FIRST_SYNCS, *IN_CAPTURE))
    ],
)
def test_every_fault_in_every_phase_is_told_and_no_accepted_pose_is_wrong(tmp_path, kind, at_sync):
    judge(kind, at_sync, tmp_path / "s")


COUNTS_PER_DEG = 400_000 / 360


def document() -> bytes:
    """What the supervisor of the exact arm takes: the paper's offsets, in counts as well."""
    made = make_document()
    joints = tuple(
        replace(joint, home_offset_counts=round(VALUES[f"theta_off_{k}"] * COUNTS_PER_DEG))
        for k, joint in enumerate(made.joints, 1)
    )
    return format_parameters(replace(made, joints=joints))


@contextmanager
def uploading(kind: str, joint: int = 4) -> Iterator[tuple[CanopenArm, bytes]]:
    """An arm under control that holds one document, and a fault that is there as the next one comes."""
    arm_file = scenario("exact").arm(load_procedure("hinge").arm)
    settings = BusSettings(channel=f"upload-{kind}")
    with run_controller(
        arm_file, Choices(scenario="exact"), settings, heartbeat_timeout_s=PATIENCE_S
    ) as controller:
        arm = fast_arm(arm_file, settings, patience_s=PATIENCE_S, sdo_timeout_s=5.0)
        arm.connect()
        arm.take_control()
        whole = document()
        arm.upload_parameters(whole)
        inject(controller, kind, joint)
        yield arm, whole
        controller.resume_loop()
        arm.close()
        # Whatever came of it, what is active is one document, whole.
        held = controller.supervisor.active_document
        assert held in (whole, whole + b"# another\n")


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=() if kind == "frames-doubled" else pytest.mark.campaign)
        for kind in FAULT_KINDS
    ],
)
def test_an_upload_ends_whole_or_not_at_all_whatever_happens(kind):
    with uploading(kind) as (arm, whole):
        other = whole + b"# another\n"
        # Refused in words, or done; anything else is raised, and fails.
        with suppress(HardwareError):
            assert arm.upload_parameters(other).length == len(other)
