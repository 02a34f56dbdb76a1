"""Planned captures on the real plant without a bus: complete, interrupted, stopped, with poses withdrawn."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from hardware.virtual.scenarios import scenario
from hardware.virtual.true_loop import Truth, paper_loop
from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.result import Solution
from operator_app.config.procedure import Procedure
from operator_app.errors import Cancelled, GuardError
from operator_app.session.store.journal import Journal, JournalEvent
from operator_app.session.workflow.campaign_replay import is_same_action
from operator_app.session.workflow.drive_selection import choose, retrace
from operator_app.session.workflow.planned_capture import PlannedCapture
from operator_app.session.workflow.session import Session
from solver.design.actions import Finished, GoTo
from tests.oracles.journal_events import event_data, journal_events
from tests.oracles.plant_arm import PlantArm
from tests.oracles.plant_sessions import RecordingListener, opened, short_procedure

CANDIDATES = 300
"""A tenth of what the product uses: these tests are about the session, not about the best poses."""


def planned_procedure(poses: int, **capture: object) -> Procedure:
    procedure = short_procedure(poses, packaged="hinge_planned")
    capture_settings = replace(procedure.capture, **capture)
    return replace(procedure, position_joints=(1, 5), capture=capture_settings)


class PlannedRun(RecordingListener):
    def __init__(self, session: Session, drives: tuple[int, ...] = (1, 5)) -> None:
        super().__init__()
        self.session = session
        self.phases: list[str] = []
        self.capture = PlannedCapture(session, drives, self, candidates=CANDIDATES)

    def planning(self, *, active: bool) -> None:
        self.phases.append("begins" if active else "ends")

    def going(self, move: GoTo | None) -> None:
        self.phases.append("moves")

    def run(self) -> Finished:
        self.session.connect()
        self.session.set_modes(self.capture.ready())
        return self.capture.run()


def interrupt(session: Session, at_sync: int) -> Session:
    """Begin a capture, interrupt it by Ctrl-C at that SYNC, and close the session."""
    session.arm.interrupt_at_sync = at_sync
    with pytest.raises(KeyboardInterrupt):
        PlannedRun(session).run()
    session.arm.interrupt_at_sync = None
    session.close("interrupted")
    return session


@pytest.fixture(scope="module")
def complete_run(tmp_path_factory):
    folder, procedure = tmp_path_factory.mktemp("complete") / "session", planned_procedure(4)
    session = opened(folder, PlantArm(procedure, "exact"), procedure)
    run = PlannedRun(session)
    end = run.run()
    session.close("done")
    return SimpleNamespace(session=session, run=run, end=end, events=journal_events(session))


def true_parameters(solution: Solution, truth: Truth) -> np.ndarray:
    table = truth.table.stacked()
    return np.array([table[e.kind, e.row] for e in solution.model.entries])


def test_complete_run_takes_the_planned_poses_and_recovers_the_arm(complete_run):
    session, run = complete_run.session, complete_run.run
    poses = session.state.poses
    assert complete_run.end.complete
    assert [p.planned for p in poses] == [False] * (len(poses) - 4) + [True] * 4
    assert run.counts == list(range(1, len(poses) + 1))
    assert any("Explored" in text and "joints 1 and 5 drive" in text for text in run.reports)
    solution = calibrate(session.model, session.fixture, session.state.pose_set())
    error = np.abs(solution.estimate.x - true_parameters(solution, paper_loop()))
    assert np.all(error < 5.0 * solution.estimate.standard_deviation)


@pytest.mark.campaign
def test_arm_far_from_its_nominal_values_is_calibrated_within_its_range(make_session):
    wild = scenario("wild", seed=3)
    session = make_session(planned_procedure(5), wild)
    assert PlannedRun(session).run().complete
    q_rad = np.array([pose.mean_rad for pose in session.state.poses])
    assert np.all((session.model.lower_rad < q_rad) & (q_rad < session.model.upper_rad))
    solution = session.calibrate()
    error = solution.estimate.x - true_parameters(solution, wild.true_loop())
    assert np.abs(error)[:5].max() < 2e-4


@pytest.mark.campaign
def test_planning_is_announced_and_nothing_moves_meanwhile(complete_run):
    phases = complete_run.run.phases
    assert phases.count("begins") == phases.count("ends") > 4
    assert all(after == "ends" for now, after in pairwise(phases) if now == "begins")


def test_return_to_the_first_pose_uses_known_paths_and_changes_no_plan(make_session):
    session = make_session(planned_procedure(4))
    run = PlannedRun(session)
    run.run()
    before, drives = session.arm.snapshot().positions_rad, session.state.position_joints
    moves = len(event_data(session, "campaign_move"))

    missed, path = run.capture.to_first()
    assert missed == ""
    assert len(path) >= 1
    first = session.state.used_poses[0].mean_rad
    assert np.abs(session.arm.snapshot().positions_rad - first).max() < math.radians(0.1)

    retrace(session, path)
    assert session.state.position_joints == drives
    assert np.abs(session.arm.snapshot().positions_rad - before).max() < math.radians(0.1)
    # A resumed session replays only what the plan proposed.
    assert len(event_data(session, "campaign_move")) == moves


def session_from(events: Sequence[JournalEvent], procedure: Procedure, folder: Path) -> Session:
    """A session resumed from these events, its arm where the last of them left it."""
    journal = Journal.create(folder)
    for event in events:
        journal.append(event.name, event.data)
    journal.close()
    positions = [e.data.get("q_rad") or e.data.get("mean_rad") for e in events]
    last = SimpleNamespace(positions_rad=np.array([q_rad for q_rad in positions if q_rad][-1]))
    arm = SimpleNamespace(snapshot=lambda: last)
    opening = SimpleNamespace(procedure=procedure)
    rig = SimpleNamespace(arm=arm, opening=opening, instrument=None, truths=None)
    return Session(rig, Journal.resume(folder))


def action_indices(events: Sequence[JournalEvent]) -> list[int]:
    actions = ("campaign_move", "campaign_drives", "pose")
    return [k for k, e in enumerate(events) if e.name in actions]


@pytest.mark.sample(2)
@pytest.mark.parametrize("share", [0.05, 0.4, 0.6, 0.8, 0.99])
def test_replay_of_a_journal_repeats_the_decisions(complete_run, tmp_path, share):
    events = complete_run.events
    indices = action_indices(events)
    k = indices[max(1, int(share * len(indices)))]
    run = PlannedRun(session_from(events[:k], complete_run.session.procedure, tmp_path / "s"))
    run.capture.ready()
    assert run.reports == []
    assert is_same_action(run.capture.campaign.propose(), events[k].name, events[k].data)


def test_complete_capture_is_not_repeated(complete_run, tmp_path):
    procedure = complete_run.session.procedure
    run = PlannedRun(session_from(complete_run.events, procedure, tmp_path / "s"))
    run.capture.ready()
    assert run.capture.run() == complete_run.end


def test_journal_that_cannot_be_replayed_is_planned_again(complete_run, tmp_path):
    events = list(complete_run.events)
    indices = action_indices(events)
    changed = events[indices[3]]
    targets = {"targets_rad": {"1": 0.5, "5": 0.5}}
    events[indices[3]] = replace(changed, data={**changed.data, **targets})
    k = indices[len(indices) // 2]
    run = PlannedRun(session_from(events[:k], complete_run.session.procedure, tmp_path / "s"))
    assert run.capture.ready() == (1, 5)
    assert "cannot be replayed" in run.reports[0]
    assert run.capture.campaign is None


@pytest.mark.campaign
@pytest.mark.parametrize("sync", [3, 700, 1500, 3700])
def test_interrupted_capture_is_completed_without_loss(make_session, sync):
    procedure = planned_procedure(3)
    poses_before = interrupt(make_session(procedure), sync).state.poses

    # A new virtual arm starts at home: farther from the last position than any real arm.
    resumed = make_session(procedure, resume=True)
    run = PlannedRun(resumed)
    end = run.run()
    assert end.complete, end.text
    exploring = bool(poses_before) and not any(p.planned for p in poses_before)
    assert any("last position first" in text for text in run.reports) is exploring
    poses = resumed.state.poses
    assert [p.number for p in poses] == list(range(1, len(poses) + 1))
    assert sum(p.planned for p in poses) == 3
    for before, after in zip(poses_before, poses, strict=False):
        np.testing.assert_array_equal(before.mean_rad, after.mean_rad)
    assert resumed.calibrate().accepted


@pytest.mark.campaign
def test_arm_that_did_not_move_continues_the_same_plan(make_session):
    procedure = planned_procedure(3)
    session = interrupt(make_session(procedure), 3800)
    assert any(p.planned for p in session.state.poses)

    resumed = make_session(procedure, resume=True, arm=session.arm)
    run = PlannedRun(resumed)
    assert run.run().complete
    assert not any("new plan" in text or "going back" in text for text in run.reports)
    assert len(event_data(resumed, "campaign")) == 1


@pytest.mark.campaign
def test_cancelled_move_continues_the_same_plan(make_session):
    session = make_session(planned_procedure(3))
    run, calls = PlannedRun(session), 0

    def cancelled() -> bool:
        """In the middle of the second move after the third pose."""
        nonlocal calls
        calls += len(session.state.poses) == 3
        return calls > 40

    session.cancelled = cancelled
    with pytest.raises(Cancelled):
        run.run()
    assert len(session.state.poses) == 3
    assert not any(m["stopped"] for m in event_data(session, "campaign_move"))
    session.cancelled = lambda: False
    assert run.run().complete
    assert len(event_data(session, "campaign")) == 1


@pytest.mark.campaign
def test_withdrawn_and_additional_poses_are_planned_beside_those_taken(make_session):
    session = make_session(planned_procedure(2))
    run = PlannedRun(session)
    run.run()
    captured = len(session.state.poses)
    session.undo()
    session.exclude(2, "bumped")
    assert run.run().complete
    expected = [n for n in range(1, captured) if n != 2]
    assert event_data(session, "campaign")[-1]["captured"] == expected
    assert sum(p.planned for p in session.state.used_poses) == 2
    session.close("done")

    explored = sum(not p.planned for p in session.state.poses)
    resumed = make_session(planned_procedure(4), resume=True)
    assert PlannedRun(resumed).run().complete
    assert sum(p.planned for p in resumed.state.poses) == 4
    assert sum(not p.planned for p in resumed.state.poses) == explored


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("poses", "requested", "weak"),
    [
        (8, {"theta_off_1_deg": math.degrees(1e-3), "a_0_mm": 1.0}, []),
        (2, {"alpha_0_deg": math.degrees(1e-12)}, ["alpha_0"]),
    ],
    ids=["reached", "out of reach"],
)
def test_requested_precision_ends_the_capture_or_is_reported(make_session, poses, requested, weak):
    session = make_session(planned_procedure(poses, requested_sigma=requested))
    end = PlannedRun(session).run()
    assert [w.name for w in end.weak] == weak
    assert all(w.sigma > w.requested == 1e-12 and w.name in end.text for w in end.weak)
    assert end.complete
    assert (sum(p.planned for p in session.state.poses) < poses) is not bool(weak)
    assert event_data(session, "campaign_ended")[-1]["text"] == end.text


@pytest.mark.campaign
def test_drives_change_during_the_capture_after_confirmed_modes(make_session):
    procedure = replace(planned_procedure(6), position_joints=None)
    session = make_session(procedure, connect=True)
    session.record("drives_chosen", {"drives": [2, 5], "sets": [[2, 5], [1, 5]], "reasons": []})
    run = PlannedRun(session, (2, 5))
    assert run.run().complete
    assert any("the drive joints from now on" in text for text in run.reports)
    names = [e.name for e in journal_events(session) if e.name in ("modes", "campaign_drives")]
    changes = [k for k, name in enumerate(names) if name == "campaign_drives"]
    assert changes
    assert all(names[k - 1] == "modes" for k in changes)
    modes = [m["modes"] for m in event_data(session, "modes")]
    assert ["position", "free", "free", "free", "position", "free", "free"] in modes


def test_chosen_drives_are_journalled_with_reasons(make_session):
    procedure = replace(planned_procedure(2), position_joints=None)
    session = make_session(procedure, connect=True)
    choice = choose(session)
    assert choice.drives == (1, 5) == session.state.drives == choice.sets[0]
    assert "reaches" in choice.reasons[0]
    (event,) = event_data(session, "drives_chosen")
    assert event["reasons"] == list(choice.reasons)
    assert event["region"][0]["drives"] == [1, 5]


@pytest.mark.campaign
def test_trial_of_drives_moves_the_arm_and_back(make_session):
    procedure = replace(planned_procedure(2), position_joints=None, trial=True)
    session = make_session(procedure, connect=True)
    start = session.arm.snapshot().positions_rad
    choice = choose(session)
    assert len(choice.trial) > 1
    assert choice.drives in [r.drives for r in choice.trial if r.usable]
    assert any(reason.startswith("on the arm:") for reason in choice.reasons)
    assert np.abs(session.arm.snapshot().positions_rad - start).max() < np.deg2rad(0.5)


def test_resumed_arm_on_another_branch_is_refused(make_session):
    procedure = planned_procedure(3)
    interrupt(make_session(procedure), 700)
    resumed = make_session(procedure, resume=True, connect=True)
    capture = PlannedRun(resumed).capture
    resumed.set_modes(capture.ready())
    # With the drives in place, joint 3 is elsewhere: another branch of the loop, or another arm.
    capture.campaign._q = capture.campaign.at_rad + np.deg2rad([0, 0, 9, 0, 0, 0, 0])
    with pytest.raises(GuardError, match="joint 3 is 9 deg off"):
        capture.run()
