"""`sarcal solve`: JSON keys, exit codes, one error for invalid input, no file written."""

import re
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from operator_app.config.resources import resolve
from tests.oracles.open_arm import write_measured_poses
from tests.oracles.parameter_documents import VALUES as TABLE_2
from tests.oracles.shop_floor import session

CONTRACT = {
    "parameters", "sigma", "rank", "unidentifiable", "scaled_condition_number", "sigma_pos_mm",
    "sigma_ori_mrad", "chi2_per_dof", "variance_components", "poses", "iterations", "verdict",
    "warnings", "interval_95", "causes", "tests", "budget", "assumed",
}  # fmt: skip
"""Keys of `solve --json` that programs rely on, whatever the verdict."""
HEADER = "placement,pose," + ",".join(f"theta{j}_deg" for j in range(1, 8))


@pytest.fixture
def exact_csv(reference_data):
    return reference_data / "hinge" / "hinge_exact.csv"


@pytest.mark.parametrize("estimator", ["implicit", "paper"])
def test_exact_poses_reproduce_table_2_to_1e_8(exact_csv, estimator, run_command, tmp_path):
    # Without knowledge of the placement: the packaged 30 mm would shift it by 1 um towards its nominal values.
    hinge = resolve("fixture", "hinge").data.decode()
    unplaced = re.sub(r"tolerance_mm: .*", "tolerance_mm: 1000", hinge)
    file = tmp_path / "hinge.yaml"
    file.write_text(re.sub(r"tolerance_deg: .*", "tolerance_deg: 180", unplaced))
    options = ["--fixture", str(file), "--estimator", estimator, "--json"]
    result = run_command(0, "solve", exact_csv, *options).json
    assert set(result["parameters"]) == set(result["sigma"]) == set(TABLE_2)
    for name, value in TABLE_2.items():
        # 1e-8 rad and 1e-8 m.
        bound = 1e-8 if name[0] in "as" and not name.startswith("alpha") else 5.7e-7
        assert result["parameters"][name] == pytest.approx(value, abs=bound), name
    assert result["rank"] == 14
    assert result["unidentifiable"] == []
    assert result["verdict"] == "accepted"
    assert result["poses"] == 60
    assert not CONTRACT - set(result)
    page = (files("operator_app.manual") / "pages/scripting.md").read_text()
    assert not [key for key in result if f"`{key}`" not in page]


def test_unsensed_wrist_is_estimated_without_its_rvdts(reference_data, run_command):
    csv = reference_data / "hinge" / "hinge_rvdt1pct.csv"
    result = run_command(0, "solve", csv, "--unsensed", "6,7", "--json").json
    values, sigma = result["parameters"], result["sigma"]
    assert "theta_off_6" not in values
    for name in (*(f"theta_off_{j}" for j in range(1, 6)), "a_0", "s_0", "s_1", "a_7", "s_7"):
        # Far inside the sigmas, as the simulated arm is more exact than its file states.
        assert abs(values[name] - TABLE_2[name]) < 0.5 * sigma[name], name
    for j in range(1, 6):
        assert values[f"theta_off_{j}"] == pytest.approx(TABLE_2[f"theta_off_{j}"], abs=0.01)


def test_unsensed_joints_are_named_where_poses_do_not_suffice(reference_data, run_command):
    csv = reference_data / "hinge" / "hinge_rvdt1pct.csv"
    head, cause, *_ = run_command(5, "solve", csv, "--unsensed", "1,2,3").out.splitlines()
    assert head.startswith("Not identifiable")
    assert "joints 1, 2 and 3" in cause


def test_rigid_fixture_reports_immobile_joint_4(exact_csv, tmp_path, run_command):
    lines = exact_csv.read_text().splitlines()
    immobile = tmp_path / "rigid.csv"
    rows = [row.split(",") for row in lines[1:]]
    for row in rows:
        row[5] = rows[0][5]
    immobile.write_text("\n".join([lines[0], *(",".join(row) for row in rows)]) + "\n")
    result = run_command(5, "solve", immobile, "--fixture", "rigid", "--json").json
    assert "theta_off_4" in result["unidentifiable"]
    assert "joint 4 does not move" in result["verdict_reasons"][0]
    assert result["verdict"] == "not_accepted"
    assert not CONTRACT - set(result)
    # The keys do not depend on the exit code.
    determined = run_command(0, "solve", exact_csv, "--json").json
    assert not set(determined) - set(result)
    assert result["estimator"] == "implicit"
    # 60 poses, 6 equations each; 7 offsets and 4 entries of the mounting.
    assert result["dof"] == 360 - 11
    assert result["rank"] == 11 - len(result["unidentifiable_directions"])
    text = run_command(5, "solve", immobile, "--fixture", "rigid").out
    assert "joint 4 does not move" in text
    assert "condition number" not in text


def test_arm_measured_as_points_is_not_identifiable(tmp_path, run_command):
    """A file of points needs no orientations: exit code 5, not an input error."""
    result = run_command(
        5, "solve", write_measured_poses(tmp_path / "points.csv"), "--fixture", "tracker", "--json"
    ).json
    assert result["unidentifiable"]
    assert result["dof"] == 3 * 40 - result["rank"] - len(result["unidentifiable_directions"])


def rows(count: int) -> list[str]:
    return [f"1,{k}," + ",".join(str(10 * k + j) for j in range(7)) for k in range(1, count + 1)]


INVALID_POSES = {
    "nan": [HEADER, *rows(3), "1,4,0,0,nan,0,0,0,0"],
    "two": [HEADER, *rows(2)],
    "radians": [HEADER, *(f"1,{k},0.6,4.1,2.5,-2,-3.5,-3.8,{k / 10}" for k in range(9))],
}


@pytest.mark.parametrize("name", INVALID_POSES)
def test_invalid_poses_are_one_error(tmp_path, run_command, name, approve):
    path = tmp_path / f"{name}.csv"
    path.write_text("\n".join(INVALID_POSES[name]) + "\n")
    answer = run_command(2, "solve", path)
    assert answer.out == ""
    approve(answer.err)
    assert list(tmp_path.iterdir()) == [path]


def test_test_file_of_another_placement_is_refused(tmp_path, run_command):
    made, new = tmp_path / "made.csv", tmp_path / "new.csv"
    made.write_text(session(5).csv())
    heading, *lines = session(5, walk=1, poses=12).csv().splitlines()
    new.write_text("\n".join([heading, *(f"2{line[1:]}" for line in lines)]) + "\n")
    error = run_command(2, "solve", made, "--test", new).err
    assert f"--test {new}: the new poses are of placement 2, which was not calibrated" in error
    new.write_text(replace(session(5), readings=np.deg2rad(session(5).readings)).csv())
    error = run_command(2, "solve", made, "--test", new).err
    assert re.search(r"no joint angle of 40 poses exceeds (.|\n)*--test .* joint 2 reads", error)


@pytest.mark.campaign
def test_result_is_tested_on_a_second_file(tmp_path, run_command):
    names = {"made": session(5), "new": session(5, walk=1, poses=12), "other": session(6, poses=12)}
    for name, taken in names.items():
        (tmp_path / f"{name}.csv").write_text(taken.csv())
    calibration_csv = str(tmp_path / "made.csv")
    result = run_command(0, "solve", calibration_csv, "--test", tmp_path / "new.csv", "--json").json
    assert result["verdict"] == "accepted"
    assert result["test"]["verdict"] == "holds"
    output = run_command(0, "solve", calibration_csv, "--test", tmp_path / "new.csv").out
    assert output.startswith("ACCEPTED: the calibration meets its limits.\n")
    # A good set may lie far below 1: the text states the upper limit.
    assert "1 or less if errors are as stated" in " ".join(output.partition("HOLDS")[2].split())
    assert "sound sets lie between" not in output
    output = run_command(4, "solve", calibration_csv, "--test", tmp_path / "other.csv").out
    # The first line has the overall verdict.
    assert "ACCEPTED, BUT DOES NOT HOLD" in output.splitlines()[0]
    assert "DOES NOT HOLD: 12 new poses disagree" in output
    output = run_command(2, "solve", calibration_csv, "--test", calibration_csv).err
    assert "these are poses that the calibration was made from" in output
