"""Drift between two calibrations: planted, wrapped, in equivalent parameters, and none where there is none."""

import math
from dataclasses import replace

import pytest
from scipy.stats import norm

from operator_app.calibration.comparison import IncomparableError, Side, compare, sides_of
from operator_app.config.parameter_records import CalibratedEntry, DocumentWarning, WhichFixture
from operator_app.report.results.comparison import comparison_json, comparison_text
from tests.oracles.parameter_documents import VALUES, make_document

ARM_SIDE = {f"theta_off_{j}" for j in range(2, 7)}
GROUND_SIDE = {"theta_off_1", "a_0", "s_0", "alpha_0", "s_1"}
HAND_SIDE = {"theta_off_7", "a_7", "s_7", "alpha_7"}


def test_calibrations_from_the_same_poses_show_no_drift():
    itself = compare(make_document(), make_document())
    assert len(itself.drifts) == 14
    sides = {side: {d.name for d in itself.drifts if d.side is side} for side in Side}
    assert sides == {Side.ARM: ARM_SIDE, Side.GROUND: GROUND_SIDE, Side.HAND: HAND_SIDE}
    assert all(d.change == 0.0 for d in itself.drifts)
    assert [n.code for n in itself.notices] == ["SAME_POSES"]
    other = replace(make_document({"theta_off_3": 0.02, "s_7": -0.0004}), estimator="paper")
    comparison = compare(make_document(), other)
    assert {n.code for n in comparison.notices} == {"SAME_POSES", "ESTIMATOR"}
    # The distance of the estimates is reported, but not as drift.
    by_name = {d.name: d for d in comparison.drifts}
    assert by_name["theta_off_3"].sigmas == pytest.approx(20.0 / math.sqrt(2.0))
    for same in (itself, comparison):
        assert same.drifted == ()
        text, data = comparison_text(same), comparison_json(same)
        assert text.startswith("SAME POSES: no conclusion about the arm.")
        assert "DRIFT" not in text
        assert "Significant" not in text
        assert data["verdict"] == "same poses: nothing follows for the arm"
        assert data["drifted"] == []
        assert not any(p["significant"] for p in data["parameters"].values())
    assert compare(make_document(), replace(other, pose_set_sha256="b" * 64)).drifted


def test_the_document_states_the_sides_of_a_ball():
    """Its D-H entries are the arm's: socket and tip are points beside the table."""
    made = make_document()
    stated = tuple(replace(entry, side="arm") for entry in made.calibrated)
    ball = replace(made, fixture=WhichFixture(name="ball", kind="ball"), calibrated=stated)
    assert set(sides_of(ball).values()) == {Side.ARM}


def test_planted_drift_is_the_only_significant_one():
    later = make_document({"theta_off_3": 0.02, "s_7": -0.0004}, poses="b")
    comparison = compare(make_document(), later)
    assert {d.name for d in comparison.drifted} == {"theta_off_3", "s_7"}
    by_name = {d.name: d for d in comparison.drifts}
    # Sigmas of make_document: 0.001 deg and 0.01 mm each.
    assert by_name["theta_off_3"].change == pytest.approx(math.radians(0.02))
    assert by_name["theta_off_3"].sigma == pytest.approx(math.radians(0.001) * math.sqrt(2.0))
    assert by_name["theta_off_3"].sigmas == pytest.approx(20.0 / math.sqrt(2.0))
    assert by_name["s_7"].sigmas == pytest.approx(40.0 / math.sqrt(2.0))
    assert comparison.drifted[0].name == "s_7"


def test_threshold_is_corrected_for_the_number_of_parameters():
    comparison = compare(make_document(), make_document(), level=0.05)
    assert comparison.threshold_sigmas == pytest.approx(norm.isf(0.025 / 14))
    just_below = comparison.threshold_sigmas * 0.001 * math.sqrt(2.0) * 0.999
    for share, drifts in ((1.0, 0), (1.002, 1)):
        later = make_document({"theta_off_5": just_below * share}, poses="b")
        assert len(compare(make_document(), later, level=0.05).drifted) == drifts


def equivalent_parameters(values):
    """The eight equivalent parameter sets of a hinge loop (deg, m), from its three symmetries."""
    sets = [values]
    for move in (
        lambda v: v | {"a_0": -v["a_0"], "alpha_0": -v["alpha_0"],
                       "theta_off_1": v["theta_off_1"] + 180.0},
        lambda v: v | {"a_7": -v["a_7"], "alpha_7": -v["alpha_7"],
                       "theta_off_7": v["theta_off_7"] - 180.0},
        lambda v: v | {"s_0": -v["s_0"], "alpha_0": v["alpha_0"] + 180.0,
                       "alpha_7": v["alpha_7"] - 180.0},
    ):  # fmt: skip
        sets += [move(v) for v in sets]
    return sets


@pytest.mark.parametrize("description", range(8))
def test_equivalent_parameter_sets_show_no_drift(description):
    values = equivalent_parameters(dict(VALUES))[description]
    comparison = compare(make_document(), make_document(values=values, poses="b"))
    assert comparison.drifted == ()
    assert max(abs(d.change) for d in comparison.drifts) < 1e-12
    drifted = make_document({"theta_off_2": 0.5}, values=values, poses="b")
    assert [d.name for d in compare(make_document(), drifted).drifted] == ["theta_off_2"]
    # The offset of an unsensed joint keeps its nominal value in every set.
    wrist = ("theta_off_6", "theta_off_7")
    values |= {"theta_off_7": VALUES["theta_off_7"]}
    unsensed = make_document(values=values, without=wrist, poses="b")
    comparison = compare(make_document(without=wrist), unsensed)
    assert len(comparison.drifts) == 12
    assert comparison.drifted == ()


def test_angle_changes_wrap_at_180_degrees():
    one = make_document(values={"theta_off_2": 179.995})
    other = make_document(values={"theta_off_2": -179.995}, poses="b")
    (drift,) = compare(one, other).drifted
    assert math.degrees(drift.change) == pytest.approx(0.01)
    (back,) = compare(other, one).drifted
    assert math.degrees(back.change) == pytest.approx(-0.01)


def test_remounted_or_other_fixture_compares_arm_parameters_only():
    later = make_document({"a_0": 0.05, "theta_off_7": 12.0, "theta_off_1": -4.0}, poses="b")
    comparison = compare(make_document(), later)
    assert len(comparison.drifted) == 3
    assert "compare with --remounted" in " ".join(comparison_text(comparison).split())
    remounted = compare(make_document(), later, remounted=True)
    assert remounted.drifted == ()
    assert {name for name, _ in remounted.left_out} == GROUND_SIDE | HAND_SIDE
    other_fixture = replace(
        make_document({"theta_off_4": 1.0}, poses="b"),
        fixture=WhichFixture(name="hinge_b", kind="hinge"),
    )
    other = compare(make_document(), other_fixture)
    assert [d.name for d in other.drifted] == ["theta_off_4"]
    assert [n.code for n in other.notices] == ["FIXTURE"]
    assert {reason for _, reason in other.left_out} == {"another fixture"}
    for comparison in (remounted, other):
        assert {d.name for d in comparison.drifts} == ARM_SIDE


def test_large_chi2_widens_the_sigmas():
    loud = make_document({"theta_off_3": 0.02}, poses="b", chi2_per_dof=100.0)
    comparison = compare(make_document(), loud)
    assert comparison.drifted == ()
    assert (comparison.scale_before, comparison.scale_after) == (1.0, 10.0)
    drift = next(d for d in comparison.drifts if d.name == "theta_off_3")
    assert drift.sigma == pytest.approx(math.radians(0.001) * math.hypot(1.0, 10.0))
    assert "CHI2" in [n.code for n in comparison.notices]
    quiet = make_document({"theta_off_3": 0.02}, poses="b", chi2_per_dof=0.5)
    assert compare(make_document(), quiet).scale_after == 1.0


def test_differences_of_method_are_listed():
    later = make_document(without=("theta_off_6",), nominal={"s_3": 0.356}, poses="b")
    later = replace(later, estimator="paper", utc=later.utc.replace(year=2020))
    comparison = compare(make_document(), later)
    codes = [n.code for n in comparison.notices]
    assert codes == ["ORDER", "ESTIMATOR", "ENTRIES", "TABLE"]
    assert "s_3 was taken as 355.0000 mm in A and 356.0000 mm in B" in comparison.notices[-1].text
    assert ("theta_off_6", "identified in A only") in comparison.left_out
    text = comparison_text(comparison)
    assert "Not compared (identified in A only): theta_off_6" in text
    assert all(len(line) <= 80 for line in text.splitlines())


def test_different_methods_do_not_blame_the_arm():
    change = {"theta_off_3": 1.0}
    same_way = make_document(change, poses="b")
    assert "The arm itself changed." in comparison_text(compare(make_document(), same_way))
    for later in (
        replace(same_way, estimator="paper"),
        make_document(change, without=("theta_off_6",), poses="b"),
        make_document(change, nominal={"s_3": 0.356}, poses="b"),
    ):
        text = " ".join(comparison_text(compare(make_document(), later)).split())
        assert "The arm itself changed" not in text
        assert "A and B were made in different ways (see below)" in text


def test_forced_calibration_is_reported():
    later = make_document(poses="b")
    text = "not accepted (too few); exported because: a demo"
    later = replace(later, warnings=(DocumentWarning(code="FORCED", text=text),))
    comparison = compare(make_document(), later)
    assert [(n.code, n.text) for n in comparison.notices] == [("FORCED", f"B was {text}")]


@pytest.mark.parametrize("changes", [{"serial": "SDA-0002"}, {"model": "franka_panda"}])
def test_other_arms_are_incomparable(changes, approve):
    document = make_document()
    other = replace(document, arm=replace(document.arm, **changes))
    with pytest.raises(IncomparableError) as error:
        compare(document, other)
    approve(str(error.value))


def test_no_common_parameter_is_incomparable():
    one, other = (make_document(without=VALUES.keys() - {f"theta_off_{j}"}) for j in (2, 3))
    with pytest.raises(IncomparableError, match="no parameter in common"):
        compare(one, other)


def test_without_sigmas_any_change_beyond_rounding_is_drift():
    one = make_document(sigma=0.0)
    other = make_document({"theta_off_3": 0.001, "theta_off_4": 1e-13}, sigma=0.0, poses="b")
    comparison = compare(one, other)
    assert [d.name for d in comparison.drifted] == ["theta_off_3"]
    assert comparison_json(comparison)["parameters"]["theta_off_3"]["sigmas"] is None
    assert "no sigma" in comparison_text(comparison)


def test_toleranced_parameters_do_not_raise_the_threshold():
    def with_lengths(document, change_m):
        more = (CalibratedEntry.of("s_3", 5e-4), CalibratedEntry.of("alpha_2", 0.1))
        rows = tuple(replace(r, s_m=r.s_m + change_m) if r.row == 3 else r for r in document.dh)
        return replace(document, calibrated=(*document.calibrated, *more), dh=rows)

    before, after = make_document(), make_document(poses="b")
    comparison = compare(with_lengths(before, 0.0), with_lengths(after, 0.0))
    assert len(comparison.drifts) == 16
    assert comparison.threshold_sigmas == compare(before, after).threshold_sigmas
    assert not comparison.drifted
    longer = compare(with_lengths(before, 0.0), with_lengths(after, 4e-3))
    assert [d.name for d in longer.drifted] == ["s_3"]
