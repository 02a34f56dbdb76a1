"""`sarcal import`: own poses and raw logs become a session on which every command works."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import sarcal

from operator_app.config.errors import ConfigError
from operator_app.config.joint_log import load_joint_log
from operator_app.config.parameters_file import load_parameters
from operator_app.config.poses_file import load_poses
from operator_app.config.resources import resolve
from tests.oracles.panda import panda_readings
from tests.oracles.recordings import recorded_arm, write_bag, write_log

HINGE = Path(__file__).parents[2] / "data/hinge"
PANDA = ["--arm", "franka_panda", "--fixture", "ball", "--drop-unidentifiable"]


def raw_logs(folder: Path, placements: tuple[int, ...]) -> list[str]:
    """The joint logs as their makers keep them: one file a socket, radians by numpy.savetxt, no header."""
    placement, q_rad = panda_readings()
    files = []
    for k in placements:
        files.append(str(folder / f"hole_{k}.csv"))
        np.savetxt(files[-1], q_rad[placement == k], delimiter=",")
    return files


def test_a_raw_log_goes_in_with_one_command(tmp_path, ends_with):
    sessions = ["--sessions", str(tmp_path / "sessions")]
    files = raw_logs(tmp_path, (1, 2))
    found = ends_with(0, "import", *files, "--rad", *PANDA, *sessions, "--json").json
    # The same poses by the way that was there before.
    converted = str(HINGE.parent / "panda_ball/panda_1.csv")
    solved = ends_with(0, "solve", converted, "--placements", "1,2", *PANDA, "--json").json
    # The file there was rounded to 1e-9 deg.
    assert found["parameters"] == pytest.approx(solved["parameters"], abs=1e-6)
    assert found["verdict"] == solved["verdict"]
    folder = Path(found["session"]["folder"])
    assert found["poses"] == 60

    assert ends_with(0, "report", folder, "--json").json["parameters"] == found["parameters"]
    ends_with(0, "report", folder)
    page = (folder / "report.html").read_text()
    assert f"The poses were read from {', '.join(files)}; this program did not capture them" in page
    ends_with(0, "report", folder, "--text")
    kept = load_poses(folder / "poses.csv").poses
    placement, q_rad = panda_readings()
    np.testing.assert_allclose(kept.q_rad, q_rad[placement <= 2], rtol=0, atol=1e-15)
    assert kept.placements == (1, 2)


@pytest.mark.campaign
def test_one_log_of_several_placements_is_that_of_a_log_each(tmp_path, ends_with):
    """A column tells the sockets apart, in words; report, compare, verify and export work on it."""
    sessions = ["--sessions", str(tmp_path / "sessions")]
    placement, q_rad = panda_readings()
    rows = [
        f"{k}.5,{('left', 'right')[p - 1]},{','.join(map(repr, q.tolist()))}"
        for k, (p, q) in enumerate(zip(placement, q_rad, strict=True))
        if p <= 2
    ]
    log = tmp_path / "log.csv"
    log.write_text("\n".join(["t,socket,q1,q2,q3,q4,q5,q6,q7", *rows]) + "\n")
    columns = ["--columns", "3-9", "--placement", "socket"]
    found = ends_with(0, "import", log, "--rad", *columns, *PANDA, *sessions, "--json").json
    apart = raw_logs(tmp_path, (1, 2))
    same = ends_with(
        0, "import", *apart, "--rad", *PANDA, *sessions, "--name", "apart", "--json"
    ).json
    assert found["parameters"] == same["parameters"]
    assert {"ground_x[1]", "ground_x[2]"} <= set(found["parameters"])
    folder = found["session"]["folder"]
    assert load_poses(f"{folder}/poses.csv").poses.notes[-1].endswith("placement right")
    ends_with(0, "compare", folder, same["session"]["folder"])
    ends_with(0, "report", folder)
    ends_with(0, "export", folder, "--format", "urdf")
    ends_with(0, "export", folder)
    said = {w.code: w.text for w in load_parameters(Path(folder) / "parameters.yaml").warnings}
    assert said["PLACEMENTS"].endswith("placement 2, the last")
    own = sarcal.poses_of(q_rad=q_rad[placement == 2][:8], placement=[2] * 8)
    said = ends_with(2, "verify", folder, own.to_csv(tmp_path / "own.csv")).err
    assert "these are poses that the calibration was made from" in said
    # As read a second time, a few encoder counts away.
    again = sarcal.poses_of(q_rad=own.q_rad + 5e-5, placement=[2] * 8)
    assert "HOLDS" in ends_with(0, "verify", folder, again.to_csv(tmp_path / "again.csv")).out
    # By number: sockets keep theirs.
    body = [[p, *q] for p, q in zip(placement, q_rad, strict=True) if p in (3, 4)]
    np.savetxt(tmp_path / "other.csv", body, delimiter=",", fmt=["%d"] + ["%.17g"] * 7)
    read = load_joint_log(tmp_path / "other.csv", joint_count=7, unit="rad", placement="1")
    assert read.poses.placements == (3, 4)


@pytest.mark.campaign
def test_it_is_reported_as_it_is_solved_and_only_an_arm_is_missing(tmp_path, ends_with):
    sessions, poses = ["--sessions", tmp_path], HINGE / "hinge_quantised.csv"
    made = ends_with(0, "import", poses, "--serial", "SDA-7", *sessions, "--json").json
    folder = made["session"]["folder"]
    solved = ends_with(0, "solve", poses, "--checks", "--json").json
    reported = ends_with(0, "report", folder, "--json").json
    for key in ("parameters", "sigma", "verdict", "checks", "chi2_per_dof", "causes"):
        assert reported[key] == solved[key], key
    assert reported["session"]["serial_number"] == "SDA-7"
    for command in (["run", "--resume", folder], ["export", folder, "--upload"]):
        assert "cannot be continued with an arm" in ends_with(2, *command, *sessions).err
    said = ends_with(2, "verify", folder, *sessions).err
    assert f"give a file of new poses: sarcal verify {folder}" in said


def test_poses_that_cannot_determine_it_all_are_kept_and_said(tmp_path, ends_with):
    sessions = ["--sessions", str(tmp_path / "sessions")]
    files = raw_logs(tmp_path, (2, 3))
    packaged = resolve("arm", "franka_panda").data.decode()
    unknown = tmp_path / "arm.yaml"
    unknown.write_text(re.sub(r"(?m)^offset_tolerance_deg: .*\n", "", packaged))
    assert unknown.read_text() != packaged
    arm = ["--arm", str(unknown), *PANDA[2:-1]]
    found = ends_with(5, "import", *files, "--rad", *arm, *sessions, "--json").json
    assert found["unidentifiable"]
    # 7 offsets, the ball's centre, and one centre for each of two sockets.
    assert found["rank"] == 7 + 3 + 2 * 3 - len(found["unidentifiable_directions"])
    assert found["dof"] == 3 * found["poses"] - 16
    assert found["session"]["uploaded"] is False
    assert len(load_poses(found["session"]["poses"]).poses) == found["poses"]
    assert ends_with(5, "report", found["session"]["folder"], "--json").json == found
    said = ends_with(5, "report", found["session"]["folder"], "--text").out
    assert "theta_off_7 cannot be separated from" in said


def test_columns_by_number_and_by_name_with_times_between(tmp_path):
    file = tmp_path / "log.txt"
    file.write_text("# a comment\nt q1 q2 speed q3\n0.0 0.5 -1.5 9 2.5\n1.0 0.25 -1.25 9 2.25\n")
    wanted = [[0.5, -1.5, 2.5], [0.25, -1.25, 2.25]]
    for columns in ("2-3,5", "2,3,5", "q1,q2,q3"):
        read = load_joint_log(file, joint_count=3, unit="rad", columns=columns)
        np.testing.assert_array_equal(read.poses.q_rad, wanted)
    turned = load_joint_log(file, joint_count=3, unit="deg", columns="q3,q1,q2")
    np.testing.assert_allclose(np.rad2deg(turned.poses.q_rad[0]), [2.5, 0.5, -1.5])


@pytest.mark.parametrize(
    ("text", "options"),
    [
        ("0.1,0.2,0.3\n" * 6, {}),
        ("1,2,3,4\n", {"unit": "deg"}),
        ("t,a,b,c\n1,2,3,4\n", {"unit": "deg"}),
        ("1,2\n", {"unit": "deg"}),
        ("1,2,3\n4,x,6\n", {"unit": "deg"}),
        ("1,2,3\n4,5\n", {"unit": "deg"}),
        ("1,2,900\n", {"unit": "rad"}),
        ("1,200,900\n" * 9, {"unit": "rad"}),
        ("t,a,b,c,p\n1,2,3,4,x\n", {"unit": "deg", "placement": "p"}),
        ("1,2,3\n", {"unit": "deg", "columns": "1-4"}),
        ("1,2,3\n", {"unit": "deg", "columns": "1,1,2"}),
        ("1,2,3\n", {"unit": "deg", "columns": "q1"}),
        ("theta1_deg,theta2_deg,theta3_deg\n1,2,3\n", {"unit": "rad"}),
        ("# nothing\n", {}),
        ("a,1,2,3\n", {"unit": "deg", "placement": "hole"}),
        ("a,1,2,3\n", {"unit": "deg", "placement": "5"}),
        ("p,a,b,c\n1,1,2,3\n,4,5,6\n", {"unit": "deg", "placement": "p"}),
        ("p,a,b,c\n1,1,2,3\n", {"unit": "deg"}),
        ("1,2,nan\n", {"unit": "deg"}),
        ("q1,q2,q3,v1,v2,v3\n1,1,1,1,1,1\n", {}),
        ("time,base,shoulder,elbow,extra\n0,1,2,3,4\n", {}),
        ("a,b\n1,2,3,4\n", {"unit": "deg"}),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_with_place_and_remedy(tmp_path, text, options, approve):
    file = tmp_path / "log.csv"
    file.write_text(text)
    with pytest.raises(ConfigError) as refused:
        load_joint_log(file, joint_count=3, **options)
    approve(str(refused.value))  # type: ignore[arg-type]


def test_a_name_that_no_file_can_have_is_an_error_in_words(ends_with, tmp_path):
    sessions = ["--sessions", str(tmp_path)]
    assert "name too long" in ends_with(2, "import", "a" * 5000, "--deg", *PANDA, *sessions).err


@pytest.mark.sample(1)
@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "csv"])
def test_a_recording_gives_the_poses_the_arm_rested_at_and_no_other(kind, tmp_path, ends_with):
    """60 real poses of two sockets, 2 s each, shuffled joints, jitter, drop-outs, 20 slow motions a socket."""
    placement, q_rad = panda_readings()
    names = [f"panda_joint{j}" for j in range(1, 8)]
    files = []
    for k in (1, 2):
        time_s, q = recorded_arm(q_rad[placement == k], decoys=20, seed=k)
        if kind == "csv":
            files.append(write_log(tmp_path / f"run_{k}.csv", time_s, q, names))
        else:
            files.append(write_bag(tmp_path / f"run_{k}", time_s, q, names, storage=kind, seed=k))
    how = ["--time", "time", "--rad"] if kind == "csv" else []
    where = ["--sessions", str(tmp_path / "sessions"), "--json"]
    said = ends_with(0, "import", *map(str, files), *how, *PANDA, *where)
    found = json.loads(said.out)
    poses = load_poses(Path(found["session"]["folder"]) / "poses.csv").poses
    assert poses.placement.tolist() == placement[placement <= 2].tolist()
    assert np.abs(poses.q_rad - q_rad[placement <= 2]).max() < 1e-6
    assert poses.samples is not None
    assert poses.samples.min() > 50
    assert poses.sd_rad is not None
    assert 1e-6 < np.median(poses.sd_rad) < 3e-6
    (first, second) = found["recordings"]
    assert len(first["poses"]) + len(second["poses"]) == 60
    assert first["joints"] == names
    assert "30 poses from" in said.err
    if kind == "mcap":
        assert poses.utc is not None
        assert poses.utc[0].startswith("2026-09-21T14:13:")


def test_what_does_not_go_with_a_recording_is_refused(tmp_path, ends_with):
    _, q_rad = panda_readings()
    time_s, q = recorded_arm(q_rad[:3], decoys=0, seed=1)
    names = [f"q{j}" for j in range(1, 8)]
    bag = str(write_bag(tmp_path / "run", time_s, q, names, storage="mcap", seed=1))
    log = write_log(tmp_path / "run.csv", time_s, q, names)
    (tmp_path / "torn.csv").write_text(log.read_text()[:-20])
    (tmp_path / "mid.csv").write_text(log.read_text().replace("\n2.", "\nx,\n2.", 1))
    (tmp_path / "two.csv").write_text(log.read_text().replace("mode,q1", "dq1,q1", 1))
    ms = write_log(tmp_path / "ms.csv", 1e3 * (time_s - time_s[0]), q, names)
    for words, said in (
        ([bag, bag], "holds the same readings as "),
        ([bag, "--rad"], "a bag has times and is in radians"),
        ([bag, "--placement", "q1"], "--placement is for logs"),
        ([bag, "--dwell-s", "0"], "--dwell-s 0: seconds"),
        (
            [bag, "--dwell-s", "3"],
            "never at rest for 3 s within 0.05 deg (smallest spread in 3 s: ",
        ),
        ([bag, "--dwell-s", "300"], "never at rest for 300 s within 0.05 deg; give another"),
        ([bag, "--spread-deg", "9"], "--spread-deg 9: degrees"),
        ([str(log), "--dwell-s", "1"], "name the time column of a log with --time"),
        ([str(log), "--time", "time"], "use --rad, or --deg"),
        ([str(log), "--time", "when"], "--time: there is no column 'when'"),
        ([str(log), "--time", "time", "--topic", "/a"], "--topic is for bags"),
        ([str(ms), "--time", "time", "--rad"], "s apart (median), too far for a dwell of 1 s"),
        (
            [str(tmp_path / "mid.csv"), "--time", "1", "--rad"],
            "has 2 cells; the lines before it have",
        ),
    ):
        assert said in ends_with(2, "import", *words, *PANDA, "--sessions", tmp_path / "s").err
    assert "is a ROS 2 bag; sarcal import" in ends_with(2, "solve", bag, *PANDA).err
    # Three poses are too few; they are found all the same.
    for words in (
        ["torn.csv", "--time", "time"],
        ["two.csv", "--time", "1", "--columns", "3-9"],
        ["two.csv", "--time", "time"],
    ):
        file, where = tmp_path / words[0], ["--sessions", tmp_path / "s"]
        said = ends_with(2, "import", file, *words[1:], "--rad", *PANDA, *where)
        assert "3 poses from" in said.err


def test_solve_and_verify_send_a_raw_log_to_import(tmp_path, ends_with):
    (log,) = raw_logs(tmp_path, (1,))
    assert f"sarcal import {log}" in ends_with(2, "solve", log, *PANDA).err
