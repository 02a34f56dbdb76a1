"""The three classes and the causes: faults of the shop floor, done to sessions that were sound."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fixtures.base import Tolerance
from operator_app.calibration.acceptance import Verdict
from operator_app.calibration.calibrate import calibrate
from operator_app.config.poses_file import parse_poses
from operator_app.messages.finding import FindingKind
from operator_app.report.text import unidentifiable_text
from solver.errors import UnidentifiableDirection, UnidentifiableError
from tests.oracles.as_shipped import ARM, HINGE, SEED, poses_of, solved
from tests.oracles.shop_floor import Specimen, closed_walk, session, taken
from tests.oracles.shop_floor_faults import CASES


def fault(name, seed=SEED):
    return CASES[name](seed)


def test_a_sound_session_is_accepted_and_every_test_says_how_often_it_would_not_be(sound):
    assert sound.verdict is Verdict.ACCEPTED
    assert sound.causes == ()
    codes = [t.code for t in sound.adjudication.tests]
    assert {"CHI2_STATED", "STEP", "POSE", "PULL", "PULLS", "PREDICTION"} <= set(codes)
    for test in sound.adjudication.tests:
        assert not test.fires
        assert 0.0 < test.false_alarm < 0.01
    assert sound.adjudication.stated_chi2_per_dof is not None


def test_what_a_fixtures_file_states_is_known_where_poses_tell_less(sound):
    """The file of a fixture measured to 0.5 mm and 5 deg knows some lengths better than 40 poses do."""
    lengths = ("a_0", "s_0", "s_1", "a_7", "s_7")
    before = sound.estimate.sd_by_name
    # Nominal values where this fixture truly is, to within what its file then states.
    nominal = {n: sound.estimate.value(n) for n in lengths}
    found = calibrate(
        ARM,
        replace(
            HINGE,
            **{f"{n.replace('7', 'n')}_m": v for n, v in nominal.items()},
            tolerance=Tolerance(position_m=0.5e-3, orientation_rad=np.deg2rad(5.0)),
        ),
        poses_of(session(SEED)),
    )
    assert found.verdict is Verdict.ACCEPTED
    sigma = found.estimate.sd_by_name
    wide = {n for n in lengths if before[n] > 0.5e-3}
    assert 0 < len(wide) < 5
    assert all(sigma[n] < 0.5e-3 for n in lengths)
    (said,) = [n.text for n in found.warnings if n.code == "AS_STATED"]
    assert {n for n in lengths if f"{n} (" in said} == {n for n in lengths if found.shares[n] < 0.5}
    assert all(f"{n} (" in said for n in wide if before[n] > 0.7e-3)


def test_poses_that_can_show_nothing_blame_nothing():
    found = session(SEED, poses=3)
    readings = found.readings.copy()
    readings[1, 3] += np.deg2rad(3.0)
    causes = solved(replace(found, readings=readings)).causes
    assert {c.code for c in causes} <= {"TOO_FEW_POSES", "LITTLE_MOTION", "NOT_CONVERGED"}
    assert (causes[0].code, causes[0].size) == ("TOO_FEW_POSES", 1), "degrees of freedom"


def test_the_scatter_of_a_mean_is_held_against_what_is_stated_of_a_mean():
    """Joint 6 scatters ten times as much as 32 readings of 2 LSB leave in their mean."""
    found = session(SEED, poses=40)
    stated = np.sqrt(ARM.joints[5].sensor.variance_of_mean_rad2(32))
    noise = 10.0 * stated * np.random.default_rng(5).standard_normal(40)
    readings = found.readings.copy()
    readings[:, 5] += noise
    causes = solved(replace(found, readings=readings)).causes
    (said,) = [c for c in causes if c.kind is FindingKind.READING_NOISE]
    assert 6.0 <= said.figures["times"] <= 14.5


def test_the_fault_is_the_first_cause_with_its_size_and_a_remedy():
    case = fault("joint slips 1 deg")
    found = solved(case.taken)
    assert found.verdict is not Verdict.ACCEPTED
    first = found.causes[0]
    assert (first.code,) == case.causes
    assert first.size is not None
    assert abs(first.size) == pytest.approx(np.deg2rad(1.0), rel=0.1)
    assert first.remedy
    assert first.probability > 0.5


def test_a_slip_is_found_between_the_poses_where_it_happened():
    specimen = Specimen.drawn(SEED, session(SEED).specimen.sizes)
    slip = np.array([0.0, 0.0, 0.0, 2e-3, 2e-3, 1e-3])
    walk = closed_walk(specimen, 40, slipped=(23, slip, np.zeros(6)))
    found = solved(taken(specimen, *walk))
    assert found.causes[0].code == "SLIP_FIXTURE"
    assert found.causes[0].poses == ("p023", "p024")


def test_a_slip_of_the_hands_half_is_no_length_and_no_outliers():
    """It has five directions: along the hinge's own axis it used to have none and was called a length."""
    found = solved(fault("hinge slips 5 mm", 3002).taken)
    assert [c.code for c in found.causes] == ["SLIP_FIXTURE"]
    assert found.causes[0].names == ("tool",)
    assert found.causes[0].figures["shift_m"] == pytest.approx(5e-3, abs=5e-5)


def test_a_length_that_no_test_is_sure_of_is_doubted_in_words_and_refuses_nothing():
    """It was ACCEPTED without a word, with an offset 4.2 of its sigmas off."""
    found = solved(fault("elbow 5 mm", 3005).taken)
    assert not any(test.fires for test in found.adjudication.tests)
    assert found.verdict is Verdict.WITH_WARNINGS
    assert {c.code for c in found.causes} == {"LENGTH_s_3", "LENGTH_s_5"}
    assert not any(c.certain for c in found.causes)


def test_so_few_poses_that_sigmas_do_not_hold_are_refused_and_more_are_warned_of():
    four, seven = (solved(session(3006, poses=n)) for n in (4, 7))
    assert four.verdict is Verdict.NOT_ACCEPTED
    assert four.causes[0].code == seven.causes[0].code == "TOO_FEW_POSES"
    assert not seven.causes[0].blocking


def test_single_readings_at_stated_noise_show_no_step_where_all_else_is_quieter():
    """Every other error of this set is far below its statement; its RVDTs' noise is as stated."""
    data = Path(__file__).resolve().parents[2] / "data" / "hinge" / "hinge_quantised.csv"
    poses = parse_poses(data.read_bytes(), data.name).poses
    found = calibrate(ARM, HINGE, poses)
    assert found.causes == ()


def test_a_stuck_sensor_is_told_from_a_joint_that_stands_still():
    case = fault("RVDT stuck")
    with pytest.raises(UnidentifiableError, match="its sensor is stuck") as error:
        solved(case.taken)
    assert any(re.fullmatch(pattern, error.value.code) for pattern in case.causes)


def test_the_paper_is_judged_by_its_distance_from_what_the_noise_says():
    found = solved(session(SEED), estimator="paper")
    test = next(t for t in found.adjudication.tests if t.code == "PAPER_DISTANCE")
    assert (found.verdict is Verdict.NOT_ACCEPTED) == test.fires


def test_the_order_of_the_poses_is_the_time_that_a_step_is_found_in():
    """Shuffled, the same readings are no step but odd poses or noise."""
    case = fault("joint slips 1 deg")
    shuffled = case.taken.picked(np.random.default_rng(0).permutation(40))
    first = solved(shuffled).causes[0]
    assert not first.code.startswith("STEP")


def test_what_does_not_fit_what_is_stated_is_not_accepted_though_its_sigmas_may_hold():
    """One reading of 13 poses off by 3 degrees: the variances grew until everything fitted."""
    found = session(SEED, poses=13)
    readings = found.readings.copy()
    readings[3, 3] += np.deg2rad(3.0)
    adjudication = solved(replace(found, readings=readings)).adjudication
    assert adjudication.stated_chi2_per_dof is not None
    assert adjudication.stated_chi2_per_dof > 20.0
    assert adjudication.causes[0].code == "OUTLIERS"
    assert adjudication.verdict is Verdict.NOT_ACCEPTED


@pytest.mark.parametrize(("joints", "leave"), [((4,), "leave it out"), ((4, 5), "leave them out")])
def test_of_a_joint_that_stands_still_the_option_that_holds_its_offset_is_named(joints, leave):
    """The poses of `sarcal run rigid` again through `sarcal solve`: the elbow stands still."""
    still = tuple(
        UnidentifiableDirection(
            parameters=(f"theta_off_{j}",), weights=(1.0,), immobile_joints=(j,)
        )
        for j in joints
    )
    said = " ".join(unidentifiable_text(UnidentifiableError(still)).split())
    assert "--drop-unidentifiable of solve and import" in said
    assert leave in said
