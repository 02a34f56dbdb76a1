"""`sarcal check`: all problems of files of any kind, else what a calibration with them would do."""

from pathlib import Path

import pytest

from operator_app.config.resources import resolve
from tests.oracles import lbr_iiwa

POSES = Path(__file__).parents[2] / "data/hinge/hinge_exact.csv"
ARM = resolve("arm", "sarcos_dextrous").data.decode()
HINGE = resolve("fixture", "hinge").data.decode()
PROCEDURE = resolve("procedure", "hinge").data.decode()


@pytest.fixture(autouse=True)
def working_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def line_of(file: str, text: str) -> int:
    return next(k for k, line in enumerate(Path(file).read_text().splitlines(), 1) if text in line)


def changed(text: str, changes: dict[str, str]) -> str:
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new, 1)
    return text


def test_built_in_files_of_two_kinds_may_have_one_name(run_command):
    output = run_command(0, "check", "--fixture", "hinge", "--procedure", "hinge").out
    assert "procedure hinge" in output
    assert "fixture hinge: hinge" in output


def test_all_problems_of_all_files_are_listed(run_command):
    arm = {
        "row: 2, theta_off_deg": "row: 2, theta_of_deg",
        "free: [theta_off_1,": "free: [",
        "home_deg: [": "home_deg: [999, ",
    }
    fixture = {"schema: sarcal/fixture/1\n": "", "kind: hinge": "kind: hing"}
    procedure = {"arm: sarcos_dextrous": "arm: a.yaml", "poses: 40": "poses: forty"}
    Path("a.yaml").write_text(changed(ARM, arm))
    Path("two.txt").write_text(changed(HINGE, fixture))
    Path("three").write_text(changed(PROCEDURE, procedure))
    Path("four.csv").write_text(POSES.read_text().replace("150.010922737073", "x", 1))
    Path("five.yaml").write_text("answer: 42\n")
    answer = run_command(
        2, "check", "four.csv", "five.yaml", "three", "a.yaml", "two.txt", "six.yaml"
    )
    assert not answer.err
    lines = answer.out.splitlines()
    for start in (
        f"! a.yaml:{line_of('a.yaml', 'theta_of_deg')}: dh[row 2].theta_of_deg: unknown key; did you mean",
        f"! a.yaml:{line_of('a.yaml', 'home_deg')}: home_deg: has 8 angles for 7 joints",
        "! two.txt:1: has no schema; the first line must be `schema: sarcal/fixture/1`",
        f"! two.txt:{line_of('two.txt', 'kind: hing')}: kind: the text 'hing' is not a known kind of fixture",
        f"! three:{line_of('three', 'forty')}: capture.poses: ",
        "! four.csv:2: theta3_deg: ",
        "! five.yaml:1: the kind of this file cannot be recognised",
        "! six.yaml: there is no such file",
    ):
        assert sum(line.startswith(start) for line in lines) == 1, (start, answer.out)
    # Problems of the arm file are listed once, although the procedure refers to it too.
    assert lines[0] == f"{len(lines) - 1} problems in 6 files:"


def test_arm_fixture_and_poses_are_checked_together(run_command):
    Path("one").write_text(ARM.replace("schema: sarcal/arm/1\n", "schema: sarcal/arm/1\n\n"))
    Path("two").write_text(HINGE)
    Path("bus").write_bytes(resolve("profile", "sarcos").data)
    Path("table").write_bytes(POSES.read_bytes())
    output = run_command(0, "check", "table", "two", "one", "bus").out
    message = " ".join(output.split())
    for fact in (
        "table 60 poses of 7 joints, 1 placement",
        "two fixture hinge: hinge",
        "one arm sarcos_dextrous: 7 joints",
        "bus bus profile sarcos",
        "1 shoulder 1 -35.0 to 115.0 encoder, 400000 counts per turn 0.0003 found",
        "6 wrist 1 -275.6 to -155.6 RVDT, 12 bits over 120.0 deg 0.0592 found",
        "Mobility 2: exactly 2 joints in position mode, the others free.",
        " would drive (reaches ",
        "14 parameters would be identified: theta_off_1,",
        "The poses of table determine all of them; scaled condition number ",
        "_mm millimetres",
    ):
        assert fact in message, (fact, output)
    assert max(map(len, output.splitlines())) <= 100


def test_setup_that_cannot_be_calibrated_is_explained(run_command):
    """The elbow in a rigid fixture (paper, section 1), and poses that are all equal."""
    Path("rigid.yaml").write_bytes(resolve("fixture", "rigid").data)
    home = ARM[ARM.index("home_deg:") :].splitlines()[0]
    other_home = "home_deg: [3.24, 210.87, 116.84, -124.23, -144.53, -172.77, 40.52]"
    Path("arm.yaml").write_text(ARM.replace(home, other_home))
    (chain,) = run_command(5, "check", "arm.yaml", "rigid.yaml", "--json").json["chains"]
    assert chain["mobility"] == 1
    assert "IMMOBILE_4" in {c["code"] for c in chain["checks"] if c["severity"] == "refused"}
    assert [j["sensor"] for j in chain["joints"]] == ["encoder"] * 5 + ["rvdt"] * 2
    message = run_command(5, "check", "--arm", "xarm6", "--fixture", "rigid").words
    assert "6 joints cannot move in a rigid fixture, which needs more than 6" in message

    header, first, *_ = POSES.read_text().splitlines()
    same = [first.replace("1,1,", f"1,{k},", 1) for k in range(1, 30)]
    Path("same.csv").write_text("\n".join([header, *same]) + "\n")
    message = run_command(5, "check", "same.csv", "--procedure", "hinge").words
    assert "! not identifiable: theta_off_" in message
    assert "Joints 1 and 5 would drive (named by the procedure" in message


def test_too_few_drives_or_name_without_kind_is_an_error(run_command):
    one_drive = {
        "{position: [1, 5]}": "{position: [5]}",
        "    - {joint: 1, from_deg: -30, to_deg: 48}\n": "",
    }
    Path("p.yaml").write_text(changed(PROCEDURE, one_drive))
    message = run_command(5, "check", "p.yaml").words
    assert "joint 5 is in position mode, but a hinge fixture leaves the arm 2 degrees" in message
    assert "use --fixture hinge or --procedure hinge" in run_command(2, "check", "hinge").err
    run_command(2, "check")


def test_poses_without_a_matching_arm_are_reported(run_command):
    rows = [f"1,{k},{0.5 * k}" for k in range(1, 9)]
    Path("one.csv").write_text("\n".join(["placement,pose,theta1_deg", *rows]) + "\n")
    unchecked = run_command(0, "check", "one.csv").words
    assert "these poses allow a calibration was not checked" in unchecked
    assert "! one.csv: no joint angle of 8 poses exceeds 4 deg: they may be in rad" in unchecked
    Path("six.urdf").write_text(lbr_iiwa.urdf(6))
    run_command(0, "new", "arm", "--urdf", "six.urdf", "-o", "six.yaml")
    command = ["check", "one.csv", "six.yaml", "--arm", "sarcos_dextrous", "--fixture", "hinge"]
    assert "! one.csv:1: poses of 1 joint, the arms have 6 and 7" in run_command(2, *command).out
