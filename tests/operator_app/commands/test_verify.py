"""`sarcal verify --open-loop`: another instrument confirms a calibration, or reports what disagrees."""

import numpy as np
import pytest

from tests.oracles.open_arm import write_measured_poses


@pytest.fixture
def folder(journalled):
    return journalled["run"]


def test_open_loop_measurement_of_calibrated_arm_agrees(folder, tmp_path, run_command):
    csv = write_measured_poses(tmp_path / "open.csv")
    result = run_command(0, "verify", folder, csv, "--open-loop", "--json").json
    assert (result["verdict"], result["disagree"]) == ("agrees", [])
    assert result["poses"] == 40
    assert {"theta_off_1", "theta_off_7"} == set(result["not_compared"])
    compared = result["parameters"]
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
def test_disagreeing_parameter_is_reported(folder, tmp_path, run_command, planted, name, size):
    csv = write_measured_poses(tmp_path / "open.csv", **planted)
    result = run_command(4, "verify", folder, csv, "--open-loop", "--json").json
    assert (result["verdict"], result["disagree"]) == ("disagrees", [name])
    row = result["parameters"][name]
    assert abs(row["change"] - size) < 3.0 * row["sigma"]
    assert f"of {name}." in run_command(4, "verify", folder, csv, "--open-loop").words


def test_instrument_worse_than_specified_is_not_accepted(folder, tmp_path, run_command):
    csv = write_measured_poses(tmp_path / "open.csv", sigma_m=5e-3)
    result = run_command(4, "verify", folder, csv, "--open-loop", "--json").json
    assert result["verdict"] == "open loop not accepted"
    assert result["reasons"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["{csv}"],
        ["--open-loop", "--procedure", "hinge"],
        ["--open-loop", "--tracker", "lab"],
        ["{csv}", "--open-loop", "--instrument", "hinge"],
        ["{csv}", "--poses", "4"],
    ],
)
def test_options_that_would_ignore_endpoints_are_refused(
    folder, tmp_path, run_command, arguments, approve
):
    csv = write_measured_poses(tmp_path / "open.csv")
    approve(run_command(2, "verify", folder, *(text.format(csv=csv) for text in arguments)).err)


@pytest.mark.campaign
def test_free_arm_is_verified_by_the_tracker(folder, tmp_path, run_command):
    options = ["--open-loop", "--json", "--poses", "8", "--sessions", tmp_path]
    answer = run_command(0, "verify", folder, *options)
    result = answer.json
    assert (result["verdict"], result["disagree"], result["poses"]) == ("agrees", [], 8)
    for name, planted in (("theta_off_2", -122.8), ("theta_off_5", 27.1)):
        row = result["parameters"][name]
        assert abs(row["open_loop"] - planted) < 4.0 * row["sigma"], name
    (session,) = tmp_path.iterdir()
    assert f"kept in {session}" in answer.err
