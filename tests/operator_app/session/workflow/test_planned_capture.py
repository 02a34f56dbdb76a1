"""Planned captures on the real plant without a bus: whole, interrupted, moved, withdrawn, stopped."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from hardware.virtual.scenarios import scenario
from hardware.virtual.true_loop import LoopTruth, paper_loop
from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.result import Solution
from operator_app.config.procedure import Procedure
from operator_app.errors import Cancelled, GuardError
from operator_app.session.store.journal import Journal, JournalEvent, read_journal
from operator_app.session.workflow.campaign_replay import is_same_action
from operator_app.session.workflow.drive_selection import choose
from operator_app.session.workflow.planned_capture import CampaignEnd, PlannedCapture
from operator_app.session.workflow.session import Session
from tests.oracles.hearing import Hearing
from tests.oracles.opened import opened
from tests.oracles.plant_arm import PlantArm
from tests.oracles.short_procedure import short_procedure

CANDIDATES = 300
"""A tenth of what the product uses: these tests are about the session, not about the best poses."""


def procedure(poses: int, **capture: object) -> Procedure:
    """The packaged planned procedure with few poses, for the arm that scenario `exact` carries."""
    found = short_procedure(poses, packaged="hinge_planned")
    return replace(found, position_joints=(1, 5), capture=replace(found.capture, **capture))


class Planned(Hearing):
    """A capture on a session, with what it said."""

    def __init__(self, session: Session, drives: tuple[int, ...] = (1, 5)) -> None:
        super().__init__()
        self.session = session
        self.capture = PlannedCapture(session, drives, self, candidates=CANDIDATES)

    def run(self) -> CampaignEnd:
        self.session.connect()
        self.session.set_modes(self.capture.ready())
        return self.capture.run()


def interrupted(session: Session, at_sync: int) -> Session:
    """Begin a capture, and end it by Ctrl-C at that SYNC."""
    session.arm.interrupt_at_sync = at_sync
    with pytest.raises(KeyboardInterrupt):
        Planned(session).run()
    session.arm.interrupt_at_sync = None
    session.close("interrupted")
    return session


def events(session: Session) -> tuple[JournalEvent, ...]:
    return read_journal(session.journal.path.parent).events


def named(session: Session, name: str) -> list[dict]:
    return [dict(e.data) for e in events(session) if e.name == name]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A planned capture from start to end on the exact arm."""
    wanted = procedure(4)
    session = opened(
        tmp_path_factory.mktemp("whole") / "session", PlantArm(wanted, "exact"), wanted
    )
    told = Planned(session)
    end = told.run()
    session.close("done")
    return SimpleNamespace(session=session, told=told, end=end, events=events(session))


def true_of(solution: Solution, truth: LoopTruth) -> np.ndarray:
    table = truth.table.stacked()
    return np.array([table[e.kind, e.row] for e in solution.model.entries])


def test_the_whole_way_takes_the_planned_poses_and_recovers_the_arm(whole):
    state = whole.session.state
    assert whole.end.complete
    assert [p.planned for p in state.poses] == [False] * (len(state.poses) - 4) + [True] * 4
    assert whole.told.heard == list(range(1, len(state.poses) + 1))
    assert any("Explored" in text and "joints 1 and 5 drive" in text for text in whole.told.said)
    solution = calibrate(whole.session.model, whole.session.fixture, state.pose_set())
    error = np.abs(solution.estimate.x - true_of(solution, paper_loop()))
    assert np.all(error < 5.0 * solution.estimate.standard_deviation)


@pytest.mark.campaign
def test_an_arm_far_from_its_files_is_explored_planned_and_known_within_its_range(make_session):
    described = scenario("wild", seed=3)
    session = make_session(procedure(5), described)
    assert Planned(session).run().complete
    read = np.array([pose.mean_rad for pose in session.state.poses])
    assert np.all((session.model.lower_rad < read) & (read < session.model.upper_rad))
    solution = session.calibrate()
    error = solution.estimate.x - true_of(solution, described.true_loop())
    assert np.abs(error)[:5].max() < 2e-4


@pytest.mark.campaign
def test_it_goes_to_its_first_pose_and_back_on_ways_that_the_plan_knows(make_session):
    session = make_session(procedure(4))
    told = Planned(session)
    told.run()
    before, drives = session.arm.snapshot().positions_rad, session.position_joints
    moves = len(named(session, "campaign_move"))

    missed, way = told.capture.to_first()
    assert missed == ""
    assert len(way) >= 1
    first = session.state.used_poses[0].mean_rad
    here = session.arm.snapshot().positions_rad
    assert np.abs(here - first).max() < math.radians(0.1)

    told.capture.retrace(way)
    assert session.position_joints == drives
    assert np.abs(session.arm.snapshot().positions_rad - before).max() < math.radians(0.1)
    # The plan knows nothing of it: a resumed session replays what it proposed, and no more.
    assert len(named(session, "campaign_move")) == moves


class Standing:
    """An arm that can only be looked at."""

    def __init__(self, q_rad: Sequence[float]) -> None:
        self.q = np.array(q_rad)

    def snapshot(self) -> SimpleNamespace:
        return SimpleNamespace(positions_rad=self.q)


def cut(whole: SimpleNamespace, count: int, folder: Path) -> Session:
    """The session as its journal's first `count` events leave it, with the arm where it was then."""
    journal = Journal.create(folder)
    for event in whole.events[:count]:
        journal.append(event.name, event.data)
    journal.close()
    left = [e.data for e in whole.events[:count] if "q_rad" in e.data or "mean_rad" in e.data]
    last = left[-1].get("q_rad") or left[-1]["mean_rad"]
    return Session(
        journal=Journal.resume(folder), arm=Standing(last), procedure=whole.session.procedure
    )


def steps(whole: SimpleNamespace) -> list[int]:
    """Where the journal has something that a campaign proposed."""
    wanted = ("campaign_move", "campaign_drives", "pose")
    return [k for k, e in enumerate(whole.events) if e.name in wanted]


@pytest.mark.sample(2)
@pytest.mark.parametrize("share", [0.05, 0.4, 0.6, 0.8, 0.99])
def test_replayed_from_the_journal_it_decides_what_it_decided_then(whole, tmp_path, share):
    places = steps(whole)
    k = places[max(1, int(share * len(places)))]
    told = Planned(cut(whole, k, tmp_path / "cut"))
    told.capture.ready()
    assert told.said == []
    campaign = told.capture.campaign
    assert campaign is not None
    assert is_same_action(campaign.propose(), whole.events[k].name, whole.events[k].data)


def test_a_finished_capture_is_not_begun_again(whole, tmp_path):
    told = Planned(cut(whole, len(whole.events), tmp_path / "cut"))
    told.capture.ready()
    assert told.capture.run() == whole.end


def test_a_journal_that_cannot_be_repeated_is_planned_anew(whole, tmp_path):
    places = steps(whole)
    k = places[len(places) // 2]
    strange = [
        replace(e, data={**e.data, "targets_rad": {"1": 0.5, "5": 0.5}}) if i == places[3] else e
        for i, e in enumerate(whole.events)
    ]
    told = Planned(cut(SimpleNamespace(events=strange, session=whole.session), k, tmp_path / "cut"))
    assert told.capture.ready() == (1, 5)
    assert "cannot be replayed" in told.said[0]
    assert told.capture.campaign is None


@pytest.mark.campaign
@pytest.mark.parametrize("sync", [3, 700, 1500, 3700])
def test_interrupted_anywhere_it_goes_on_with_nothing_lost(make_session, sync):
    wanted = procedure(3)
    session = interrupted(make_session(wanted), sync)
    kept = session.state.poses

    # A virtual arm stands at its home again: farther from where it was than any real one would be.
    again = make_session(wanted, resume=True)
    told = Planned(again)
    end = told.run()
    assert end.complete, end.text
    exploring = bool(kept) and not any(p.planned for p in kept)
    assert any("last position first" in text for text in told.said) is exploring
    poses = again.state.poses
    assert [p.number for p in poses] == list(range(1, len(poses) + 1))
    assert sum(p.planned for p in poses) == 3
    for before, after in zip(kept, poses, strict=False):
        np.testing.assert_array_equal(before.mean_rad, after.mean_rad)
    assert again.calibrate().accepted


@pytest.mark.campaign
def test_an_arm_that_stayed_where_it_was_goes_on_with_the_same_plan(make_session):
    wanted = procedure(3)
    session = interrupted(make_session(wanted), 3800)
    assert any(p.planned for p in session.state.poses)

    again = make_session(wanted, resume=True, arm=session.arm)
    told = Planned(again)
    assert told.run().complete
    assert not any("anew" in text or "going back" in text for text in told.said)
    assert len(named(again, "campaign")) == 1


@pytest.mark.campaign
def test_the_operator_ends_a_move_and_goes_on(make_session):
    session = make_session(procedure(3))
    told, moves = Planned(session), 0

    def cancelled() -> bool:
        """In the middle of the second move after the third pose."""
        nonlocal moves
        moves += len(session.state.poses) == 3
        return moves > 40

    session.cancelled = cancelled
    with pytest.raises(Cancelled):
        told.run()
    assert len(session.state.poses) == 3
    assert not any(m["stopped"] for m in named(session, "campaign_move"))
    session.cancelled = lambda: False
    assert told.run().complete
    assert len(named(session, "campaign")) == 1


@pytest.mark.campaign
def test_a_withdrawn_pose_no_longer_counts_in_the_plan(make_session):
    session = make_session(procedure(2))
    told = Planned(session)
    told.run()
    first = len(session.state.poses)
    session.undo()
    session.exclude(2, "bumped")
    end = told.run()
    assert end.complete
    begun = named(session, "campaign")
    assert begun[-1]["captured"] == [n for n in range(1, first) if n != 2]
    assert sum(p.planned for p in session.state.used_poses) == 2


@pytest.mark.campaign
def test_more_poses_wanted_on_resuming_are_planned_beside_those_taken(make_session):
    session = make_session(procedure(2))
    Planned(session).run()
    session.close("done")
    explored = sum(not p.planned for p in session.state.poses)
    again = make_session(procedure(4), resume=True)
    end = Planned(again).run()
    assert end.complete
    assert sum(p.planned for p in again.state.poses) == 4
    assert sum(not p.planned for p in again.state.poses) == explored


@pytest.mark.campaign
@pytest.mark.parametrize(
    ("poses", "requested", "weak"),
    [
        (8, {"theta_off_1_deg": math.degrees(1e-3), "a_0_mm": 1.0}, []),
        (2, {"alpha_0_deg": math.degrees(1e-12)}, ["alpha_0"]),
    ],
    ids=["reached", "out of reach"],
)
def test_precision_asked_for_ends_it_early_and_what_stays_weak_is_named(
    make_session, poses, requested, weak
):
    session = make_session(procedure(poses, requested_sigma=requested))
    end = Planned(session).run()
    assert [w.name for w in end.weak] == weak
    assert all(w.sigma > w.requested == 1e-12 and w.name in end.text for w in end.weak)
    assert end.complete
    assert (sum(p.planned for p in session.state.poses) < poses) is not bool(weak)
    assert named(session, "campaign_ended")[-1]["text"] == end.text


@pytest.mark.campaign
def test_the_drives_change_in_the_middle_and_are_read_back(make_session):
    wanted = replace(procedure(6), position_joints=None)
    session = make_session(wanted, connect=True)
    session.record("drives_chosen", {"drives": [2, 5], "sets": [[2, 5], [1, 5]], "reasons": []})
    told = Planned(session, (2, 5))
    assert told.run().complete
    changes = named(session, "campaign_drives")
    assert changes
    assert any("the drive joints from now on" in text for text in told.said)
    # Every change was a change of modes on the arm, confirmed, before it was told to the campaign.
    order = [e.name for e in events(session) if e.name in ("modes", "campaign_drives")]
    for k, name in enumerate(order):
        if name == "campaign_drives":
            assert order[k - 1] == "modes"
    modes = [m["modes"] for m in named(session, "modes")]
    assert ["position", "free", "free", "free", "position", "free", "free"] in modes


def test_chosen_drives_come_with_reasons(make_session):
    session = make_session(replace(procedure(2), position_joints=None), connect=True)
    choice = choose(session)
    assert choice.drives == (1, 5) == session.state.drives
    assert choice.drives == choice.sets[0]
    assert "reaches" in choice.reasons[0]
    kept = named(session, "drives_chosen")[0]
    assert kept["reasons"] == list(choice.reasons)
    assert kept["region"][0]["drives"] == [1, 5]


@pytest.mark.campaign
def test_a_trial_moves_the_arm_and_counts(make_session):
    session = make_session(replace(procedure(2), position_joints=None, trial=True), connect=True)
    start = session.arm.snapshot().positions_rad
    choice = choose(session)
    assert len(choice.trial) > 1
    assert choice.drives in [r.drives for r in choice.trial if r.usable]
    assert any(reason.startswith("on the arm:") for reason in choice.reasons)
    # There and back.
    assert np.abs(session.arm.snapshot().positions_rad - start).max() < np.deg2rad(0.5)


def test_an_arm_that_does_not_come_back_is_said(make_session):
    wanted = procedure(3)
    interrupted(make_session(wanted), 700)
    again = make_session(wanted, resume=True)
    # Joint 3 stands elsewhere with the drives in place: another branch of the loop, or another arm.
    told = Planned(again)
    again.connect()
    again.set_modes(told.capture.ready())
    told.capture.campaign._q = told.capture.campaign.at_rad + np.deg2rad([0, 0, 9, 0, 0, 0, 0])
    with pytest.raises(GuardError, match="joint 3 is 9 deg off"):
        told.capture.run()
