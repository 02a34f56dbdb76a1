"""`sarcal verify --open-loop`: another instrument agrees with a sound calibration, and names what does not."""

import numpy as np
import pytest

from tests.oracles.open_arm import measured_csv


@pytest.fixture
def folder(journalled):
    return journalled["run"]


def test_an_arm_that_is_what_was_found_agrees(folder, tmp_path, ends_with):
    csv = measured_csv(tmp_path / "open.csv")
    found = ends_with(0, "verify", folder, csv, "--open-loop", "--json").json
    assert (found["verdict"], found["disagree"]) == ("agrees", [])
    assert found["poses"] == 40
    assert {"theta_off_1", "theta_off_7"} == set(found["not_compared"])
    compared = found["parameters"]
    assert {f"theta_off_{j}" for j in range(2, 7)} < set(compared)
    for name, value in (("theta_off_2", -122.8), ("theta_off_5", 27.1), ("s_5", 0.320)):
        row = compared[name]
        assert abs(row["open_loop"] - value) < 3.0 * row["sigma"], name


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("planted", "name", "size"),
    [
        ({"wrong_rad": {3: np.deg2rad(1.0)}}, "theta_off_3", 1.0),
        ({"longer_m": {5: 0.010}}, "s_5", 0.010),
    ],
)
def test_what_disagrees_is_named(folder, tmp_path, ends_with, planted, name, size):
    csv = measured_csv(tmp_path / "open.csv", **planted)
    found = ends_with(4, "verify", folder, csv, "--open-loop", "--json").json
    assert (found["verdict"], found["disagree"]) == ("disagrees", [name])
    row = found["parameters"][name]
    assert abs(row["change"] - size) < 3.0 * row["sigma"]
    assert f"of {name}." in ends_with(4, "verify", folder, csv, "--open-loop").words


def test_an_instrument_worse_than_its_file_says_proves_nothing(folder, tmp_path, ends_with):
    csv = measured_csv(tmp_path / "open.csv", sigma_m=5e-3)
    found = ends_with(4, "verify", folder, csv, "--open-loop", "--json").json
    assert found["verdict"] == "open loop not accepted"
    assert found["reasons"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["{csv}"],
        ["--open-loop", "--procedure", "hinge"],
        ["--open-loop", "--tracker", "lab"],
        ["{csv}", "--open-loop", "--instrument", "hinge"],
    ],
)
def test_endpoints_are_never_ignored_in_silence(folder, tmp_path, ends_with, arguments, approve):
    csv = measured_csv(tmp_path / "open.csv")
    approve(ends_with(2, "verify", folder, *(text.format(csv=csv) for text in arguments)).err)


@pytest.mark.campaign
def test_on_the_arm_out_of_its_hinge_it_is_judged_by_the_tracker(folder, tmp_path, ends_with):
    given = ["--open-loop", "--json", "--poses", "8", "--sessions", tmp_path]
    told = ends_with(0, "verify", folder, *given)
    found = told.json
    assert (found["verdict"], found["disagree"], found["poses"]) == ("agrees", [], 8)
    for name, planted in (("theta_off_2", -122.8), ("theta_off_5", 27.1)):
        row = found["parameters"][name]
        assert abs(row["open_loop"] - planted) < 4.0 * row["sigma"], name
    (made,) = tmp_path.iterdir()
    assert f"kept in {made}" in told.err
