"""`sarcal solve` as a script sees it: JSON, exit codes, one clear message, nothing written."""

import re
from importlib.resources import files

import pytest

from operator_app.config.resources import resolve
from tests.oracles.open_arm import measured_csv
from tests.oracles.parameter_documents import VALUES as TRUTH
from tests.oracles.shop_floor import session

CONTRACT = {
    "parameters", "sigma", "rank", "unidentifiable", "scaled_condition_number", "sigma_pos_mm",
    "sigma_ori_mrad", "chi2_per_dof", "variance_components", "poses", "iterations", "verdict",
    "warnings",
}  # fmt: skip
HEADER = "placement,pose," + ",".join(f"theta{j}_deg" for j in range(1, 8))


@pytest.fixture
def exact_csv(reference_data):
    return reference_data / "hinge" / "hinge_exact.csv"


@pytest.mark.parametrize("estimator", ["implicit", "paper"])
def test_exact_poses_give_table_2_to_1e_8(exact_csv, estimator, ends_with, tmp_path):
    # Of a fixture of whose place nothing is known: within the packaged 30 mm it would be drawn 1 um to its file's.
    hinge = resolve("fixture", "hinge").data.decode()
    anywhere = re.sub(r"tolerance_mm: .*", "tolerance_mm: 1000", hinge)
    file = tmp_path / "hinge.yaml"
    file.write_text(re.sub(r"tolerance_deg: .*", "tolerance_deg: 180", anywhere))
    options = ["--fixture", str(file), "--estimator", estimator, "--json"]
    found = ends_with(0, "solve", exact_csv, *options).json
    assert set(found) >= CONTRACT
    assert set(found["parameters"]) == set(found["sigma"]) == set(TRUTH)
    for name, value in TRUTH.items():
        # 1e-8 rad and 1e-8 m.
        bound = 1e-8 if name[0] in "as" and not name.startswith("alpha") else 5.7e-7
        assert found["parameters"][name] == pytest.approx(value, abs=bound), name
    assert found["rank"] == 14
    assert found["unidentifiable"] == []
    assert found["verdict"] == "accepted"
    assert found["poses"] == 60
    assert not PROMISED - set(found)
    page = (files("operator_app.manual") / "pages/scripting.md").read_text()
    assert not [key for key in found if f"`{key}`" not in page]


PROMISED = CONTRACT | {"interval_95", "causes", "tests", "budget", "assumed"}
"""Keys of `solve --json` that programs rely on, whatever came of it."""


def test_unsensed_wrist_on_the_rvdt_set(reference_data, ends_with):
    csv = reference_data / "hinge" / "hinge_rvdt1pct.csv"
    whole = ends_with(0, "solve", csv, "--unsensed", "6,7", "--json").json
    found, sigma = whole["parameters"], whole["sigma"]
    assert "theta_off_6" not in found
    for name in (*(f"theta_off_{j}" for j in range(1, 6)), "a_0", "s_0", "s_1", "a_7", "s_7"):
        # The arm is exact and its file does not know that: right, and far inside the sigmas.
        assert abs(found[name] - TRUTH[name]) < 0.5 * sigma[name], name
    for j in range(1, 6):
        assert found[f"theta_off_{j}"] == pytest.approx(TRUTH[f"theta_off_{j}"], abs=0.01)


def test_rigid_refuses_by_naming_joint_4(exact_csv, tmp_path, ends_with):
    lines = exact_csv.read_text().splitlines()
    still = tmp_path / "rigid.csv"
    rows = [row.split(",") for row in lines[1:]]
    for row in rows:
        row[5] = rows[0][5]
    still.write_text("\n".join([lines[0], *(",".join(row) for row in rows)]) + "\n")
    found = ends_with(5, "solve", still, "--fixture", "rigid", "--json").json
    assert "theta_off_4" in found["unidentifiable"]
    assert "joint 4 does not move" in found["verdict_reasons"][0]
    assert found["verdict"] == "not_accepted"
    assert not PROMISED - set(found)
    # A script reads the same keys whatever the exit code is.
    determined = ends_with(0, "solve", exact_csv, "--json").json
    assert not set(determined) - set(found)
    assert found["estimator"] == "implicit"
    # 60 poses, 6 equations each; 7 offsets and 4 entries of the mounting.
    assert (found["dof"], found["rank"]) == (360 - 11, 11 - len(found["unidentifiable_directions"]))
    said = ends_with(5, "solve", still, "--fixture", "rigid").out
    assert "joint 4 does not move" in said
    assert "condition number" not in said


def test_an_arm_measured_as_points_is_not_identifiable_and_no_input_error(tmp_path, ends_with):
    """Said was that orientations are missing, which a file of points need not have."""
    found = ends_with(
        5, "solve", measured_csv(tmp_path / "points.csv"), "--fixture", "tracker", "--json"
    ).json
    assert found["unidentifiable"]
    assert found["dof"] == 3 * 40 - found["rank"] - len(found["unidentifiable_directions"])


def rows(count: int) -> list[str]:
    return [f"1,{k}," + ",".join(str(10 * k + j) for j in range(7)) for k in range(1, count + 1)]


BAD_POSES = {
    "nan": [HEADER, *rows(3), "1,4,0,0,nan,0,0,0,0"],
    "six": [",".join(HEADER.split(",")[:-1]), "1,1,0,0,0,0,0,0"],
    "zero": [HEADER],
    "one": [HEADER, *rows(1)],
    "two": [HEADER, *rows(2)],
    "twice": [HEADER, *rows(3), rows(1)[0]],
    "radians": [HEADER, *(f"1,{k},0.6,4.1,2.5,-2,-3.5,-3.8,{k / 10}" for k in range(9))],
}


@pytest.mark.parametrize("name", BAD_POSES)
def test_bad_poses_get_one_clear_message_and_exit_code_2(tmp_path, ends_with, name, approve):
    path = tmp_path / f"{name}.csv"
    path.write_text("\n".join(BAD_POSES[name]) + "\n")
    said = ends_with(2, "solve", path)
    assert said.out == ""
    approve(said.err)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    "options",
    [
        ["missing.csv"],
        ["missing.csv", "--arm", "sarcos"],
        ["missing.csv", "--fixture", "hing"],
        ["missing.csv", "--unsensed", "six"],
        ["missing.csv", "--unsensed", "9"],
        ["missing.csv", "--unsensed", "0"],
        ["missing.csv", "--unsensed", ","],
        ["missing.csv", "--unsensed", "6", "--estimator", "paper"],
        ["missing.csv", "--unsensed", "1" * 5000],
    ],
)
def test_bad_options_say_what_there_is(options, approve, ends_with):
    said = ends_with(2, "solve", *options)
    assert said.out == ""
    approve(said.err)


@pytest.mark.campaign
def test_the_result_is_tested_on_a_second_file(tmp_path, ends_with):
    """Another walk of the same arm holds; the same file is refused; another arm's poses do not hold."""
    names = {"made": session(5), "new": session(5, walk=1, poses=12), "other": session(6, poses=12)}
    for name, taken in names.items():
        (tmp_path / f"{name}.csv").write_text(taken.csv())
    made = str(tmp_path / "made.csv")
    found = ends_with(0, "solve", made, "--test", tmp_path / "new.csv", "--json").json
    assert found["verdict"] == "accepted"
    assert found["test"]["verdict"] == "holds"
    said = ends_with(0, "solve", made, "--test", tmp_path / "new.csv").out
    assert said.startswith("ACCEPTED: the calibration meets its limits.\n")
    # A sound set may well lie far below 1: what is stated is the most that is allowed.
    assert "1 or less if errors are as stated" in " ".join(said.partition("HOLDS")[2].split())
    assert "sound sets lie between" not in said
    said = ends_with(4, "solve", made, "--test", tmp_path / "other.csv").out
    # Nobody reads on after good news.
    assert "ACCEPTED, BUT DOES NOT HOLD" in said.splitlines()[0]
    assert "DOES NOT HOLD: 12 new poses disagree" in said
    said = ends_with(2, "solve", made, "--test", made).err
    assert "these are poses that the calibration was made from" in said
    # What took part among what did not, to the decimals that a table shows.
    head, *own = (tmp_path / "made.csv").read_text().splitlines()
    rounded = [",".join(f"{float(c):.3f}" if "." in c else c for c in r.split(",")) for r in own]
    (tmp_path / "mixed.csv").write_text(session(5, walk=1, poses=12).csv())
    others = (tmp_path / "mixed.csv").read_text().splitlines()[1:]
    named = [f"1,{k},{row.split(',', 2)[2]}" for k, row in enumerate(others + rounded[:3], 101)]
    (tmp_path / "mixed.csv").write_text("\n".join([head, *named]) + "\n")
    said = ends_with(2, "solve", made, "--test", tmp_path / "mixed.csv").err
    assert "3 of the 15 poses (113, 114, 115) are poses that" in said


def test_the_order_of_the_rows_changes_no_printed_character(reference_data, tmp_path, ends_with):
    csv = reference_data / "hinge" / "hinge_rvdt1pct.csv"
    header, *rows = csv.read_text().splitlines()
    other = tmp_path / "other.csv"
    other.write_text("\n".join([header, *rows[1::2], *reversed(rows[::2])]) + "\n")
    for form in ([], ["--json"]):
        said = ends_with(0, "solve", csv, *form).out
        assert "theta_off_7" in said
        assert ends_with(0, "solve", other, *form).out == said
