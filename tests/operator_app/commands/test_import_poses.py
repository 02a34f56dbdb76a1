"""`sarcal import`: poses files, raw logs and recordings become a session for every other command."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import sarcal

from operator_app.config.joint_log import load_joint_log
from operator_app.config.parameters_file import load_parameters
from operator_app.config.poses_file import load_poses
from operator_app.config.resources import resolve
from tests.oracles.open_arm import write_measured_poses
from tests.oracles.panda import panda_readings
from tests.oracles.recordings import recorded_arm, write_bag, write_log

HINGE = Path(__file__).parents[2] / "data/hinge"
PANDA = ["--arm", "franka_panda", "--fixture", "ball", "--drop-unidentifiable"]


def write_raw_logs(folder: Path, placements: tuple[int, ...]) -> list[str]:
    """Write one log per socket: radians by numpy.savetxt, no header."""
    placement, q_rad = panda_readings()
    files = []
    for k in placements:
        files.append(str(folder / f"hole_{k}.csv"))
        np.savetxt(files[-1], q_rad[placement == k], delimiter=",")
    return files


def test_raw_logs_are_imported_like_a_converted_poses_file(tmp_path, run_command):
    sessions = ["--sessions", str(tmp_path / "sessions")]
    files = write_raw_logs(tmp_path, (1, 2))
    imported = run_command(0, "import", *files, "--rad", *PANDA, *sessions, "--json").json
    # The same poses, rounded to 1e-9 deg.
    converted = str(HINGE.parent / "panda_ball/panda_1.csv")
    solved = run_command(0, "solve", converted, "--placements", "1,2", *PANDA, "--json").json
    assert imported["parameters"] == pytest.approx(solved["parameters"], abs=1e-6)
    assert imported["verdict"] == solved["verdict"]
    folder = Path(imported["session"]["folder"])
    assert imported["poses"] == 60

    assert run_command(0, "report", folder, "--json").json["parameters"] == imported["parameters"]
    run_command(0, "report", folder)
    page = (folder / "report.html").read_text()
    assert f"The poses were read from {', '.join(files)}; this program did not capture them" in page
    run_command(0, "report", folder, "--text")
    stored = load_poses(folder / "poses.csv").poses
    placement, q_rad = panda_readings()
    np.testing.assert_allclose(stored.q_rad, q_rad[placement <= 2], rtol=0, atol=1e-15)
    assert stored.placements == (1, 2)


def test_log_of_an_instrument_is_imported_with_its_endpoints(tmp_path, run_command):
    poses = load_poses(write_measured_poses(tmp_path / "poses.csv")).poses
    rows = np.hstack((np.rad2deg(poses.q_rad), poses.endpoint))
    rows_log, time_log = tmp_path / "rows.csv", tmp_path / "time.csv"
    header = ",".join([*(f"q{j}" for j in range(1, 8)), "x_m", "y_m", "z_m"])
    np.savetxt(rows_log, rows, delimiter=",", header=header, comments="", fmt="%.9f")
    times = [10.0 * k + 0.1 * i for k in range(len(rows)) for i in range(20)]
    over_time = np.column_stack((times, np.repeat(rows, 20, axis=0)))
    np.savetxt(time_log, over_time, delimiter=",", header=f"time,{header}", comments="", fmt="%.9f")
    options = ["--fixture", "tracker", "--drop-unidentifiable", "--sessions", tmp_path / "s"]
    expected = run_command(0, "solve", tmp_path / "poses.csv", *options[:3], "--json").json
    for command in ("solve", "import"):
        message = run_command(2, command, HINGE / "hinge_quantised.csv", *options[:2]).err
        assert "hinge_quantised.csv: the poses have no endpoints" in message
    for log, timed in ((rows_log, []), (time_log, ["--time", "time"])):
        found = run_command(0, "import", log, *timed, "--deg", *options, "--json").json
        assert found["poses"] == 40
        for name, value in expected["parameters"].items():
            assert abs(found["parameters"][name] - value) < 0.1 * expected["sigma"][name], name


@pytest.mark.campaign
def test_one_log_with_placements_equals_one_log_each(tmp_path, run_command):
    """A text column states the socket; report, compare, verify and export accept the session."""
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
    imported = run_command(0, "import", log, "--rad", *columns, *PANDA, *sessions, "--json").json
    logs = write_raw_logs(tmp_path, (1, 2))
    separate = run_command(
        0, "import", *logs, "--rad", *PANDA, *sessions, "--name", "apart", "--json"
    ).json
    assert imported["parameters"] == separate["parameters"]
    assert {"ground_x[1]", "ground_x[2]"} <= set(imported["parameters"])
    folder = imported["session"]["folder"]
    assert load_poses(f"{folder}/poses.csv").poses.notes[-1].endswith("placement right")
    run_command(0, "compare", folder, separate["session"]["folder"])
    run_command(0, "report", folder)
    run_command(0, "export", folder, "--format", "urdf")
    run_command(0, "export", folder)
    warnings = load_parameters(Path(folder) / "parameters.yaml").warnings
    (placements,) = (w.text for w in warnings if w.code == "PLACEMENTS")
    assert placements.endswith("placement 2, the last")
    # A second reading, a few encoder counts away.
    poses = sarcal.poses_of(q_rad=q_rad[placement == 2][:8] + 5e-5, placement=[2] * 8)
    assert "HOLDS" in run_command(0, "verify", folder, poses.to_csv(tmp_path / "again.csv")).out
    # Placements given as numbers keep them.
    rows_by_number = [[p, *q] for p, q in zip(placement, q_rad, strict=True) if p in (3, 4)]
    np.savetxt(tmp_path / "other.csv", rows_by_number, delimiter=",", fmt=["%d"] + ["%.17g"] * 7)
    log_by_number = load_joint_log(tmp_path / "other.csv", joint_count=7, unit="rad", placement="1")
    assert log_by_number.poses.placements == (3, 4)


@pytest.mark.campaign
def test_imported_session_is_reported_as_solved_but_has_no_arm(tmp_path, run_command):
    sessions, poses = ["--sessions", tmp_path], HINGE / "hinge_quantised.csv"
    imported = run_command(0, "import", poses, "--serial", "SDA-7", *sessions, "--json").json
    folder = imported["session"]["folder"]
    solved = run_command(0, "solve", poses, "--checks", "--json").json
    reported = run_command(0, "report", folder, "--json").json
    for key in ("parameters", "sigma", "verdict", "checks", "chi2_per_dof", "causes"):
        assert reported[key] == solved[key], key
    assert reported["session"]["serial_number"] == "SDA-7"
    for command in (["run", "--resume", folder], ["export", folder, "--upload"]):
        assert "cannot be continued with an arm" in run_command(2, *command, *sessions).err
    message = run_command(2, "verify", folder, *sessions).err
    assert f"give a file of new poses: sarcal verify {folder}" in message


def test_insufficient_poses_are_kept_and_reported(tmp_path, run_command):
    sessions = ["--sessions", str(tmp_path / "sessions")]
    files = write_raw_logs(tmp_path, (2, 3))
    packaged = resolve("arm", "franka_panda").data.decode()
    unknown = tmp_path / "arm.yaml"
    unknown.write_text(re.sub(r"(?m)^offset_tolerance_deg: .*\n", "", packaged))
    assert unknown.read_text() != packaged
    arm = ["--arm", str(unknown), *PANDA[2:-1]]
    imported = run_command(5, "import", *files, "--rad", *arm, *sessions, "--json").json
    assert imported["unidentifiable"]
    # 7 offsets, the centre of the ball, and the centres of two sockets.
    assert imported["rank"] == 7 + 3 + 2 * 3 - len(imported["unidentifiable_directions"])
    assert imported["dof"] == 3 * imported["poses"] - 16
    assert imported["session"]["uploaded"] is False
    assert len(load_poses(imported["session"]["poses"]).poses) == imported["poses"]
    assert run_command(5, "report", imported["session"]["folder"], "--json").json == imported
    report = run_command(5, "report", imported["session"]["folder"], "--text").out
    assert "theta_off_7 cannot be separated from" in report


@pytest.mark.sample(1)
@pytest.mark.parametrize("kind", ["mcap", "sqlite3", "csv"])
def test_recording_gives_exactly_the_poses_at_standstill(kind, tmp_path, run_command):
    """60 real poses of two sockets, 2 s each; shuffled joints, jitter, lost samples, 20 slow motions a socket."""
    placement, q_rad = panda_readings()
    names = [f"panda_joint{j}" for j in range(1, 8)]
    files = []
    for k in (1, 2):
        time_s, q = recorded_arm(q_rad[placement == k], decoys=20, seed=k)
        if kind == "csv":
            files.append(write_log(tmp_path / f"run_{k}.csv", time_s, q, names))
        else:
            files.append(write_bag(tmp_path / f"run_{k}", time_s, q, names, storage=kind, seed=k))
    options = ["--time", "time", "--rad"] if kind == "csv" else []
    output = ["--sessions", str(tmp_path / "sessions"), "--json"]
    answer = run_command(0, "import", *map(str, files), *options, *PANDA, *output)
    imported = json.loads(answer.out)
    poses = load_poses(Path(imported["session"]["folder"]) / "poses.csv").poses
    assert poses.placement.tolist() == placement[placement <= 2].tolist()
    assert np.abs(poses.q_rad - q_rad[placement <= 2]).max() < 1e-6
    assert poses.samples.min() > 50
    assert poses.sd_rad is not None
    assert 1e-6 < np.median(poses.sd_rad) < 3e-6
    (first, second) = imported["recordings"]
    assert len(first["poses"]) + len(second["poses"]) == 60
    assert first["joints"] == names
    assert "30 poses from" in answer.err
    if kind == "mcap":
        assert poses.utc[0].startswith("2026-09-21T14:13:")


def test_invalid_recording_or_option_is_refused(tmp_path, run_command):
    _, q_rad = panda_readings()
    time_s, q = recorded_arm(q_rad[:3], decoys=0, seed=1)
    names = [f"q{j}" for j in range(1, 8)]
    bag = str(write_bag(tmp_path / "run", time_s, q, names, storage="mcap", seed=1))
    log = write_log(tmp_path / "run.csv", time_s, q, names)
    (tmp_path / "torn.csv").write_text(log.read_text()[:-20])
    (tmp_path / "mid.csv").write_text(log.read_text().replace("\n2.", "\nx,\n2.", 1))
    (tmp_path / "two.csv").write_text(log.read_text().replace("mode,q1", "dq1,q1", 1))
    ms = write_log(tmp_path / "ms.csv", 1e3 * (time_s - time_s[0]), q, names)
    for arguments, message in (
        ([bag, bag], "holds the same readings as "),
        ([bag, "--rad"], "a bag has times and is in radians"),
        ([bag, "--placement", "q1"], "--placement is for logs"),
        ([bag, "--dwell-s", "0"], "--dwell-s: 0 is not a number between 0.01 and 3600 s"),
        (
            [bag, "--dwell-s", "3"],
            "never at rest for 3 s within 0.05 deg (smallest spread in 3 s: ",
        ),
        ([bag, "--dwell-s", "300"], "never at rest for 300 s within 0.05 deg; give another"),
        ([bag, "--spread-deg", "9"], "--spread-deg: 9 is not a number between 0.0001 and 5 deg"),
        ([str(log), "--dwell-s", "1"], "name the time column of a log with --time"),
        ([str(log), "--time", "time"], "use --rad, or --deg"),
        ([str(log), "--time", "when"], "--time: there is no column 'when'"),
        ([str(log), "--time", "time", "--topic", "/a"], "--topic is for bags"),
        ([str(ms), "--time", "time", "--rad"], "s apart (median), too far for a dwell of 1 s"),
        ([tmp_path / "mid.csv", "--time", "1", "--rad"], "has 2 cells; the lines before it have"),
    ):
        errors = run_command(2, "import", *arguments, *PANDA, "--sessions", tmp_path / "s").err
        assert message in errors
    assert "is a ROS 2 bag; sarcal import" in run_command(2, "solve", bag, *PANDA).err
    # Three poses are too few for a calibration, but they are found.
    for arguments in (
        ["torn.csv", "--time", "time"],
        ["two.csv", "--time", "1", "--columns", "3-9"],
        ["two.csv", "--time", "time"],
    ):
        file, where = tmp_path / arguments[0], ["--sessions", tmp_path / "s"]
        answer = run_command(2, "import", file, *arguments[1:], "--rad", *PANDA, *where)
        assert "3 poses from" in answer.err


def test_solve_refers_a_raw_log_to_import(tmp_path, run_command):
    (log,) = write_raw_logs(tmp_path, (1,))
    assert f"sarcal import {log}" in run_command(2, "solve", log, *PANDA).err
