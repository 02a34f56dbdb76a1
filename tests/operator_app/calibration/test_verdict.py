"""The three classes and the causes: faults of the shop floor, done to sessions that were sound."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fixtures.base import Tolerance
from operator_app.calibration.foretold import FIXTURE, MadeFrom
from operator_app.calibration.loop import loop_of_poses
from operator_app.calibration.noise import error_model, soften
from operator_app.calibration.solution import Solution
from operator_app.calibration.solve import calibrate
from operator_app.calibration.verdict import NamedCause, Verdict, causes_of, each_once
from operator_app.calibration.verify import Prediction, fixed_by, judge_poses
from operator_app.calibration.why_not import why_blind
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import parse_poses
from operator_app.report.facts import facts_of
from operator_app.report.text import facts_text
from solver.errors import PosesDoNotFitError, UnidentifiableDirection, UnidentifiableError
from solver.estimators.estimate import Estimate
from solver.estimators.paper import estimate_paper
from solver.estimators.variance_components import estimate_with_errors
from solver.judging.candidate import Candidate, Cause
from solver.judging.evidence import Evidence, evidence, evidence_of_own
from solver.judging.ranges import ReadingsOutOfRangeError
from solver.judging.stated_tests import Test as Trying
from solver.judging.trial import Explanation, Trial, judge
from tests.oracles.shop_floor import Session, Specimen, closed_walk, session, taken
from tests.oracles.shop_floor_faults import CASES, Case

SEED = 3001


def solved(found: Session, **options: str) -> Solution:
    poses = parse_poses(found.csv().encode(), "poses.csv").poses
    arm, hinge = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
    return calibrate(arm, hinge, poses, **options)


def fault(name: str, seed: int = SEED) -> Case:
    return CASES[name](seed)


@pytest.fixture(scope="module")
def sound() -> Solution:
    return solved(session(SEED))


def test_a_sound_session_is_accepted_and_every_test_says_how_often_it_would_not_be(
    sound: Solution,
) -> None:
    assert sound.verdict is Verdict.ACCEPTED
    assert sound.causes == ()
    codes = [t.code for t in sound.judgement.tests]
    assert {"CHI2_STATED", "STEP", "POSE", "PULL", "PULLS", "PREDICTION"} <= set(codes)
    for test in sound.judgement.tests:
        assert not test.fires
        assert 0.0 < test.false_alarm < 0.01
    assert sound.judgement.stated_chi2_per_dof is not None


def test_no_sigma_exceeds_what_the_fixtures_file_states_without_a_word(sound: Solution) -> None:
    """The file of a fixture measured to 0.5 mm and 5 deg knows some lengths better than 40 poses do."""
    arm, hinge = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
    names = [p.name for p in sound.estimate.parameters]
    sigma = dict(zip(names, sound.estimate.standard_deviation, strict=True))
    wide = {n for n in ("a_0", "s_0", "s_1", "a_7", "s_7") if sigma[n] > 0.5e-3}
    assert 0 < len(wide) < 5
    found = calibrate(
        arm,
        replace(hinge, tolerance=Tolerance(position_m=0.5e-3, orientation_rad=np.deg2rad(5.0))),
        parse_poses(session(SEED).csv().encode(), "poses.csv").poses,
    )
    assert found.verdict is Verdict.WITH_WARNINGS
    (cause,) = found.causes
    assert cause.code == "LITTLE_MOTION"
    assert "no better than was known before" in cause.text
    assert set(re.findall(r"(\w+) \(", cause.text)) == wide
    # What may be off is said before any figure, and once.
    head, *rest = facts_text(facts_of(found)).split("\n\n")
    assert " ".join(head.split()).endswith(f"- {cause.text}: {cause.remedy}")
    assert "no better than was known before" not in " ".join(" ".join(rest).split())


def test_what_is_named_again_is_said_once_and_goes_on_refusing() -> None:
    def named(code: str, text: str, *, refuses: bool) -> NamedCause:
        return NamedCause(code=code, probability=0.5, text=text, remedy="look", refuses=refuses)

    found = each_once(
        [
            named("ENCODER_1", "errs by 0.064 deg", refuses=False),
            named("OUTLIERS", "pose 3", refuses=False),
            named("ENCODER_1", "errs by 0.058 deg", refuses=True),
        ]
    )
    assert [(c.code, c.text, c.refuses) for c in found] == [
        ("ENCODER_1", "errs by 0.064 deg", True),
        ("OUTLIERS", "pose 3", False),
    ]


def test_poses_that_can_show_nothing_blame_nothing() -> None:
    found = session(SEED, poses=3)
    readings = found.readings.copy()
    readings[1, 3] += np.deg2rad(3.0)
    causes = solved(replace(found, readings=readings)).causes
    assert {c.code for c in causes} <= {"TOO_FEW_POSES", "LITTLE_MOTION", "NOT_CONVERGED"}
    assert "1 degree of freedom is too few" in causes[0].text


def test_the_scatter_of_a_mean_is_held_against_what_is_stated_of_a_mean() -> None:
    """Joint 6 scatters ten times as much as 32 readings of 2 LSB leave in their mean."""
    found = session(SEED, poses=40)
    arm = load_arm("sarcos_dextrous")
    stated = np.sqrt(arm.joints[5].sensor.variance_of_mean_rad2(32))
    noise = 10.0 * stated * np.random.default_rng(5).standard_normal(40)
    readings = found.readings.copy()
    readings[:, 5] += noise
    (said,) = [
        c.text for c in solved(replace(found, readings=readings)).causes if "scatters by" in c.text
    ]
    times = re.search(r"(\d+) times its specification", said)
    assert times is not None
    assert 6 <= int(times[1]) <= 14


def campaign(*values: str):
    return pytest.param(*values, marks=pytest.mark.campaign)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("hinge slips 5 mm", r"slipped on the (table|hand) by about [345]\.\d mm"),
        (
            "joint slips 1 deg",
            r"joint \d shifted by [+-](0\.9|1\.0)\d* deg \([+-]\d+ (LSB|counts)\)",
        ),
        campaign("1 outlier 0.5 deg", r"pose p\d+ does not fit the others"),
        campaign("RVDT 5 %", r"joint [67] (strays|scatters) .*deg"),
        campaign("12 flipped", r"12 of 40\) close only with the hand upside down"),
    ],
)
def test_the_fault_is_the_first_cause_with_its_size_and_a_remedy(name: str, words: str) -> None:
    case = fault(name)
    found = solved(case.taken)
    assert found.verdict is not Verdict.ACCEPTED
    first = found.causes[0]
    assert any(re.fullmatch(pattern, first.code) for pattern in case.causes), first
    assert re.search(words, first.text), first.text
    assert first.remedy
    assert first.probability > 0.5


def test_a_slip_is_found_between_the_poses_where_it_happened() -> None:
    specimen = Specimen.drawn(SEED, session(SEED).specimen.sizes)
    slip = np.array([0.0, 0.0, 0.0, 2e-3, 2e-3, 1e-3])
    walk = closed_walk(specimen, 40, slipped=(23, slip, np.zeros(6)))
    found = solved(taken(specimen, *walk))
    assert found.causes[0].code == "SLIP_FIXTURE"
    assert "between pose p023 and pose p024" in found.causes[0].text


def test_a_slip_of_the_hands_half_is_no_length_and_no_outliers() -> None:
    """It has five directions: along the hinge's own axis it used to have none and was called a length."""
    found = solved(fault("hinge slips 5 mm", 3002).taken)
    assert [c.code for c in found.causes] == ["SLIP_FIXTURE"]
    assert "slipped on the hand by about 5.0 mm" in found.causes[0].text


def test_a_length_that_no_test_is_sure_of_is_doubted_in_words_and_refuses_nothing() -> None:
    """It was ACCEPTED without a word, with an offset 4.2 of its sigmas off."""
    found = solved(fault("elbow 5 mm", 3005).taken)
    assert not any(test.fires for test in found.judgement.tests)
    assert found.verdict is Verdict.WITH_WARNINGS
    assert {c.code for c in found.causes} == {"LENGTH_s_3", "LENGTH_s_5"}
    assert all("may be off the arm file by about" in c.text for c in found.causes)


def test_so_few_poses_that_sigmas_do_not_hold_are_refused_and_more_are_warned_of() -> None:
    four, seven = (solved(session(3006, poses=n)) for n in (4, 7))
    assert four.verdict is Verdict.NOT_ACCEPTED
    assert four.causes[0].code == seven.causes[0].code == "TOO_FEW_POSES"
    assert not seven.causes[0].refuses


def test_a_sensor_is_not_called_out_of_specification_within_three_of_its_sigmas(
    sound: Solution,
) -> None:
    for verdict in sound.rvdt:
        figures = verdict.figures
        if figures is not None and verdict.verdict.value == "out of specification":
            assert figures.linearity - 3.0 * figures.linearity_sd > 0.02


def test_single_readings_at_stated_noise_show_no_step_where_all_else_is_quieter() -> None:
    """Every other error of this set is far below its statement; its RVDTs' noise is as stated."""
    data = Path(__file__).resolve().parents[2] / "data" / "hinge" / "hinge_quantised.csv"
    poses = parse_poses(data.read_bytes(), data.name).poses
    found = calibrate(load_arm("sarcos_dextrous"), load_fixture("hinge").fixture, poses)
    assert found.causes == ()


def test_mistakes_of_the_file_are_refused_by_name() -> None:
    with pytest.raises(ReadingsOutOfRangeError) as error:
        solved(fault("radians").taken)
    assert error.value.code == "RADIANS"
    with pytest.raises(ReadingsOutOfRangeError) as error:
        solved(fault("columns exchanged").taken)
    assert error.value.code.startswith("EXCHANGED_")


def test_a_stuck_sensor_is_told_from_a_joint_that_stands_still() -> None:
    case = fault("RVDT stuck")
    with pytest.raises(UnidentifiableError, match="its sensor is stuck") as error:
        solved(case.taken)
    assert any(re.fullmatch(pattern, error.value.code) for pattern in case.causes)


def test_the_paper_is_judged_by_its_distance_from_what_the_noise_says() -> None:
    found = solved(session(SEED), estimator="paper")
    test = next(t for t in found.judgement.tests if t.code == "PAPER_DISTANCE")
    assert (found.verdict is Verdict.NOT_ACCEPTED) == test.fires


def test_the_order_of_the_poses_is_the_time_that_a_step_is_found_in() -> None:
    """Shuffled, the same readings are no step but odd poses or noise."""
    case = fault("joint slips 1 deg")
    shuffled = case.taken.picked(np.random.default_rng(0).permutation(40))
    first = solved(shuffled).causes[0]
    assert not first.code.startswith("STEP")


def test_verification_holds_a_slip_against_the_calibration_whatever_noise_that_found(
    sound: Solution,
) -> None:
    arm, hinge = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture

    def poses_of(found: Session):
        return parse_poses(found.csv().encode(), "new.csv").poses

    fixed = fixed_by(sound)
    assert judge_poses(arm, hinge, poses_of(session(SEED, walk=1, poses=12)), fixed).holds
    specimen = Specimen.drawn(SEED, session(SEED).specimen.sizes)
    slip = np.array([0.0, 0.0, 0.0, 4e-3, 2e-3, 2e-3])
    walk = closed_walk(specimen, 12, walk=1, slipped=(0, slip, np.zeros(6)))
    moved = poses_of(taken(specimen, *walk))
    assert not judge_poses(arm, hinge, moved, fixed).holds
    excused = replace(fixed, fixture_variance=np.full(6, 1e-2), rvdt_sd_rad={6: 1.0, 7: 1.0})
    assert not judge_poses(arm, hinge, moved, excused).holds


@pytest.fixture(scope="module")
def retaken(sound: Solution) -> tuple[MadeFrom, Session]:
    """A sound calibration with its poses, and poses of the same arm taken later."""
    poses = parse_poses(session(SEED).csv().encode(), "old.csv").poses
    return MadeFrom(solution=sound, poses=poses), session(SEED, walk=1, poses=20)


def _judged(retaken: tuple[MadeFrom, Session], readings: np.ndarray) -> Prediction:
    made, later = retaken
    poses = parse_poses(replace(later, readings=readings).csv().encode(), "new.csv").poses
    arm, hinge = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
    return judge_poses(arm, hinge, poses, fixed_by(made.solution), made=made)


def test_what_a_calibration_has_seen_of_sensors_and_sag_is_no_trouble_in_later_poses(
    retaken: tuple[MadeFrom, Session],
) -> None:
    found = _judged(retaken, retaken[1].readings)
    assert found.holds
    assert (found.shift, found.odd_poses) == (None, ())


@pytest.mark.parametrize(("joint", "deg"), [(2, 0.2), (4, -0.1), (6, 0.5), (7, 0.5)])
def test_a_joint_that_reads_otherwise_in_all_later_poses_is_named_with_its_size(
    retaken: tuple[MadeFrom, Session], joint: int, deg: float
) -> None:
    """Though an RVDT may bend by 2.4 deg: how it bends is known from the calibration."""
    readings = retaken[1].readings.copy()
    readings[:, joint - 1] += np.deg2rad(deg)
    found = _judged(retaken, readings)
    assert not found.holds
    shift = found.shift
    assert shift is not None
    assert shift.size is not None
    assert shift.sigma is not None
    assert shift.subject == str(joint)
    assert abs(shift.size - np.deg2rad(deg)) < 4.0 * shift.sigma
    assert found.odd_poses == ()


def test_one_pose_that_is_off_makes_a_calibration_not_hold_and_is_named_alone(
    retaken: tuple[MadeFrom, Session],
) -> None:
    readings = retaken[1].readings.copy()
    readings[4, 1] += np.deg2rad(0.3)
    found = _judged(retaken, readings)
    assert not found.holds
    assert (found.shift, found.odd_poses) == (None, (4,))


def test_a_fixture_that_stands_elsewhere_is_named_as_such(sound: Solution) -> None:
    specimen = Specimen.drawn(SEED, session(SEED).specimen.sizes)
    slip = np.array([0.0, 0.0, 0.0, 2e-3, 1e-3, 1e-3])
    moved = taken(specimen, *closed_walk(specimen, 20, walk=1, slipped=(0, slip, np.zeros(6))))
    poses = parse_poses(session(SEED).csv().encode(), "old.csv").poses
    found = _judged((MadeFrom(solution=sound, poses=poses), moved), moved.readings)
    assert not found.holds
    assert found.shift is not None
    assert found.shift.subject == FIXTURE


def test_what_does_not_fit_what_is_stated_is_not_accepted_though_its_sigmas_may_hold() -> None:
    """One reading of 13 poses off by 3 degrees: the variances grew until everything fitted."""
    found = session(SEED, poses=13)
    readings = found.readings.copy()
    readings[3, 3] += np.deg2rad(3.0)
    judgement = solved(replace(found, readings=readings)).judgement
    assert judgement is not None
    assert judgement.stated_chi2_per_dof is not None
    assert judgement.stated_chi2_per_dof > 20.0
    assert judgement.causes[0].code == "OUTLIERS"
    assert judgement.verdict is Verdict.NOT_ACCEPTED


def tried(found: Session) -> tuple[Trial, Estimate]:
    """What the tests say of a session, and the estimate they judge."""
    arm, hinge = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
    poses = parse_poses(found.csv().encode(), "poses.csv").poses
    model, tolerance = soften(loop_of_poses(arm, hinge, poses), arm)
    errors = error_model(arm, hinge, poses, np.arange(len(poses)), tolerance=tolerance)
    made = estimate_with_errors(model, poses.q_rad, errors)
    return judge(made.linear, arm, taken=made.order), made.estimate


def test_what_has_no_name_is_not_said_to_scatter_more_than_stated_where_it_does_not() -> None:
    trial, estimate = tried(session(SEED))
    labels = tuple(str(k) for k in range(40))
    by_chance = replace(trial, tests=(Trying(code="STEP", statistic=9.0, threshold=8.0),))
    (cause,) = causes_of(by_chance, estimate, ("theta_off_2",), labels)
    assert cause.code == "UNNAMED"
    assert not cause.refuses
    assert "no more than the files state" in cause.text
    assert "(STEP)" in cause.text
    assert causes_of(trial, estimate, ("theta_off_2",), labels) == ()


def test_a_cause_that_refuses_is_named_however_many_come_before_it(sound: Solution) -> None:
    """Five that move nothing compete in the first round; what is found in the second one moves joint 6 far."""
    trial = tried(session(SEED))[0]
    some = [c for c in trial.scene.standing() if c.cause in (Cause.DRIFT, Cause.SCALE)]
    drifts = [c for c in some if c.cause is Cause.DRIFT]
    slight = [
        Explanation(candidate=c, evidence=weighed(trial, c, b=0.0), probability=0.15)
        for c in (*drifts[:5], *(c for c in some if c.cause is Cause.SCALE))
    ]
    gross = Explanation(
        candidate=drifts[5], evidence=weighed(trial, drifts[5], b=0.1), probability=0.9
    )

    def named(first: list[Explanation]) -> list[tuple[str, bool]]:
        both = replace(trial, rounds=(tuple(first), (gross,)))
        labels = tuple(str(k) for k in range(40))
        found = causes_of(both, sound.estimate, ("theta_off_2",), labels)
        return [(cause.code, cause.refuses) for cause in found]

    five = [(f"DRIFT_JOINT_{j}", False) for j in (1, 2, 3, 4, 5)]
    assert named(slight[:4]) == [*five[:4], ("DRIFT_JOINT_6", True)]
    assert named(slight[:5]) == [*five, ("DRIFT_JOINT_6", True)]
    assert named(slight) == [*five, ("DRIFT_JOINT_6", True)]


@pytest.mark.parametrize(
    ("kind", "subject", "may", "does", "denied"),
    [
        (
            Cause.GIVES,
            "",
            "the fixture may give about 0.0",
            "the fixture gives about 0.0",
            "0.0 mm",
        ),
        (
            Cause.LENGTH,
            "s_2",
            "s_2 may be off the arm file by",
            "s_2 is off the arm file by",
            " 0.0 mm",
        ),
        (Cause.DRIFT, "2", "joint 2 may drift by about", "joint 2 drifts by about", "0.0000 deg"),
    ],
)
def test_what_is_less_likely_than_not_may_be_and_its_size_is_not_nought(
    sound: Solution, kind: Cause, subject: str, may: str, does: str, denied: str
) -> None:
    trial = tried(session(SEED))[0]
    chosen = next(
        c
        for c in trial.scene.standing()
        if c.cause is kind and (not subject or str(c.subject) == subject)
    )
    for chance, words in ((0.04, may), (0.96, does)):
        one = Explanation(
            candidate=chosen, evidence=weighed(trial, chosen, b=1e-7), probability=chance
        )
        labels = tuple(str(k) for k in range(40))
        (cause,) = causes_of(
            replace(trial, rounds=((one,),)), sound.estimate, ("theta_off_2",), labels
        )
        assert words in cause.text, cause.text
        assert denied not in cause.text, cause.text


def weighed(trial: Trial, candidate: Candidate, *, b: float) -> Evidence:
    """Its evidence, had its coefficients come out as `b` and moved no parameter."""
    if candidate.own is None:
        found = evidence(trial.left, candidate.columns, candidate.natural)
    else:
        found = evidence_of_own(trial.left, candidate.own, candidate.columns, candidate.natural)
    assert found is not None
    return replace(found, b=np.full_like(found.b, b), moved=np.zeros_like(found.moved))


def test_loops_that_nothing_closes_are_said_to_be_open_and_no_parameter_to_be_unseen() -> None:
    """Readings that scatter by 2 degrees: what an estimate that ended nowhere cannot see says nothing."""
    found = session(8001)
    noise = np.random.default_rng(5)
    for _ in range(2):
        # The third draw is the one that came out as parameters that cannot be seen.
        noise.normal(size=found.readings.shape)
    readings = found.readings + np.deg2rad(2.0) * noise.normal(size=found.readings.shape)
    taken = replace(found, readings=readings)
    judgement = solved(taken).judgement
    assert judgement is not None
    assert judgement.verdict is Verdict.NOT_ACCEPTED
    poses = parse_poses(taken.csv().encode(), "poses.csv").poses
    arm, hinge = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
    blind = UnidentifiableError(
        (UnidentifiableDirection(parameters=("theta_off_1",), weights=(1.0,)),)
    )
    paper = estimate_paper(hinge.model(arm), poses.q_rad)
    why = why_blind(blind, arm, hinge, poses, (), paper, None)
    assert isinstance(why, PosesDoNotFitError)
    assert "the loops stay open by 10.53 mm and" in str(why)
