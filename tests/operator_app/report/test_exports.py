"""Exports read by the tools that they are for; frames of a URDF by pinocchio."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import sarcal
from scipy.io import loadmat

from operator_app.calibration.calibrated_arm import T_base_flange
from operator_app.config.arm_file import load_arm
from operator_app.config.parameters_file import load_parameters
from operator_app.config.urdf_editing import format_urdf
from operator_app.config.urdf_reading import parse_urdf
from solver.chain.kinematics import DhTable
from tests.oracles.panda import FOLDER as PANDA
from tests.oracles.urdfs import places

HINGE = Path(__file__).parents[2] / "data/hinge/hinge_exact.csv"


@pytest.mark.parametrize("which", ["result", "ball"])
def test_exported_urdf_has_our_frames_in_pinocchio(which, request, tmp_path):
    result: sarcal.Result = request.getfixturevalue(which)
    urdf = result.export(tmp_path / "arm.urdf").read_bytes()
    arm = result.arm
    q = np.random.default_rng(1).uniform(arm.lower_rad, arm.upper_rad, (200, arm.joint_count))
    frames = {"flange": q} | ({"tip": result.poses.q_rad[:50]} if which == "ball" else {})
    for frame, angles in frames.items():
        expected = result.fk(angles, frame=frame)
        np.testing.assert_allclose(places(urdf, angles, frame), expected, rtol=0, atol=1e-9)
    model = pin.buildModelFromXML(urdf.decode())
    np.testing.assert_allclose(model.lowerPositionLimit, arm.lower_rad, rtol=0, atol=1e-12)
    np.testing.assert_allclose(model.upperPositionLimit, arm.upper_rad, rtol=0, atol=1e-12)


def test_export_into_an_own_urdf(result, tmp_path, run_command):
    arm = load_arm("sarcos_dextrous")
    own, sessions = tmp_path / "own.urdf", ["--sessions", tmp_path / "sessions"]
    own.write_bytes(format_urdf(arm, arm.table))
    run_command(0, "import", HINGE, *sessions)
    (folder,) = (tmp_path / "sessions").iterdir()
    run_command(0, "export", folder, "--format", "urdf", "--into", own)
    written = (folder / "own_calibrated.urdf").read_bytes()
    assert b"theta_off_3: " in written
    by_library = result.export(tmp_path / "program.urdf", into=own).read_bytes()
    q = result.poses.q_rad
    expected = result.fk(q, frame="flange")
    for urdf in (written, by_library):
        np.testing.assert_allclose(places(urdf, q, "flange"), expected, rtol=0, atol=1e-9)
    run_command(2, "export", folder, "--format", "csv", "--into", own)
    run_command(2, "export", folder, "--into", own, "-o", own)
    run_command(2, "export", folder, "--into", PANDA / "panda_1.csv")


def test_urdf_excludes_parameters_of_the_mounting(result, tmp_path):
    text = result.export(tmp_path / "arm.urdf").read_text()
    table = parse_urdf(text.encode(), "arm.urdf").table
    nominal = load_arm("sarcos_dextrous").table
    off, best = np.rad2deg(table.theta_off_rad), result.to_json()["best_table"]
    for j in (2, 3, 4, 5, 6):
        assert off[j - 1] == pytest.approx(best[f"theta_off_{j}"], abs=1e-9)
    for j in (1, 7):
        assert off[j - 1] == pytest.approx(np.rad2deg(nominal.theta_off_rad[j - 1]), abs=1e-9)
        assert abs(off[j - 1] - result.values[f"theta_off_{j}_deg"]) > 0.01
    assert table.s_m[0] == table.s_m[6] == table.a_m[6] == 0.0
    assert "depend on the mounting" in text
    assert "theta_off_1, theta_off_7, a_0, s_0, alpha_0, s_1, a_7, s_7, alpha_7" in text


@pytest.mark.parametrize("unsensed", [(), (6, 7)])
def test_every_export_has_the_tool_of_the_last_mounting(unsensed, tmp_path):
    """The zero of joint 7 counts from the hinge, and is 0.3 rad off in the second placement."""
    loop = {"arm": "sarcos_dextrous", "fixture": "hinge"}
    made = sarcal.simulate(**loop, poses=50, seed=0)
    q = made.poses.q_rad - 0.3 * np.outer(np.arange(50) >= 30, np.arange(7) == 6)
    poses = sarcal.poses_of(q_rad=q, placement=[1] * 30 + [2] * 20)
    result = sarcal.calibrate(**loop, poses=poses, unsensed_joints=unsensed)
    tips, q = result.fk(q[30:])[:, :3, 3], q[30:]
    urdf = result.export(tmp_path / "arm.urdf", force="no jump").read_bytes()
    np.testing.assert_allclose(places(urdf, q, "tip")[:, :3, 3], tips, rtol=0, atol=1e-9)
    assert (b"theta_off_6: the mean" in urdf) == bool(unsensed)
    document = load_parameters(result.export(tmp_path / "p.yaml", force="no jump"))
    rows = document.table.stacked()[:, 1:]
    assert np.rad2deg(rows[0, 5]) == pytest.approx(made.truth["theta_off_6_deg"], abs=1.0)
    rows[:2, 0] = result.arm._model.table.stacked()[:2, 0]
    apart = np.linalg.norm(T_base_flange(DhTable.from_stacked(rows), q)[:, :3, 3] - tips, axis=-1)
    assert (apart < (1e-9 if unsensed else 2.0 * result.tip_sigma(q))).all()
    assert ("with the identified" in result.table("accuracy")._facts.note) == bool(unsensed)


@pytest.mark.parametrize("serial", ["SDA\x1b[31m-1", "a\0b", "-->", "a---b", "x-", "\ufffe & <b>"])
def test_dh_table_survives_the_urdf_with_any_serial_number(serial):
    arm, rng = load_arm("franka_panda"), np.random.default_rng(3)
    rows = arm.table.stacked()
    rows[:4] += rng.normal(size=(4, 7)) * np.array([[0.05], [1e-3], [1e-3], [2e-3]])
    table = DhTable.from_stacked(rows)
    text = format_urdf(replace(arm, name=f"arm {serial}"), table, comment=[f"serial {serial}"])
    read = parse_urdf(text, "x").table
    np.testing.assert_allclose(read.stacked(), rows, rtol=0, atol=1e-12)
    assert "\x1b" not in text.decode()


def test_csv_json_mat_and_yaml_agree(result, tmp_path, run_command):
    folder = result.save(tmp_path / "s")
    for kind in ("csv", "json", "mat", "urdf", "yaml"):
        run_command(0, "export", folder, "--format", kind)
    with (folder / "parameters.csv").open(newline="") as file:
        rows = {row["parameter"]: row for row in csv.DictReader(file)}
    document = json.loads((folder / "result.json").read_text())
    mat = loadmat(folder / "result.mat", simplify_cells=True)
    parameters = load_parameters(folder / "parameters.yaml")
    sigmas = {e.entry: e.sigma for e in parameters.calibrated}
    assert list(rows) == list(document["parameters"]) == mat["names"].tolist()
    for k, (name, row) in enumerate(rows.items()):
        unit = f"{name}_{row['unit']}"
        assert float(row["value"]) == pytest.approx(result.values[unit], rel=1e-12)
        assert float(row["sigma"]) == pytest.approx(result.sigmas[unit], rel=1e-12)
        scale = 1.0 if row["unit"] == "deg" else 1e3
        assert scale * document["parameters"][name] == pytest.approx(float(row["value"]), rel=1e-12)
        in_si = np.deg2rad(float(row["value"])) if scale == 1.0 else float(row["value"]) / 1e3
        assert mat["value_rad_or_m"][k] == pytest.approx(in_si, rel=1e-12)
        assert scale * sigmas[name] == pytest.approx(float(row["sigma"]), rel=1e-9)
        assert row["side"] == document["side"][name] == mat["side"][k]
    names, entries = list(rows), [e.entry for e in parameters.calibrated]
    for k, late in enumerate(entries):
        for j, early in enumerate(entries[:k]):
            if {late, early} <= rows.keys():
                expected = document["correlations"][names.index(late)][names.index(early)]
                assert parameters.correlations[late][j] == pytest.approx(expected, abs=6e-6)
    assert parameters.budget.keys() == document["budget"].keys() == set(names)
    for name, shares in parameters.budget.items():
        for source, share in document["budget"][name].items():
            assert shares.get(source, 0.0) == pytest.approx(share, abs=6e-5)
    assert [r["side"] for n, r in rows.items() if n in ("theta_off_1", "theta_off_2", "a_7")] == [
        "ground", "arm", "hand",
    ]  # fmt: skip
    np.testing.assert_allclose(
        mat["T_base_tip"][..., 3], result.fk(result.poses.q_rad[3]), atol=1e-12
    )
    assert (folder / "result.mat").read_bytes().startswith(b"MATLAB 5.0 MAT-file")
    urdf = (folder / "arm.urdf").read_bytes()
    csv_text = run_command(0, "export", folder, "--format", "csv", "-o", "-").out
    assert csv_text.startswith("parameter,side,unit,nominal,value,sigma\n")
    run_command(2, "export", folder, "--format", "urdf", "--upload")
    # The file ending chooses the format.
    other = tmp_path / "mine.urdf"
    run_command(0, "export", folder, "-o", other)
    assert other.read_bytes() == urdf
    message = run_command(2, "export", folder, "-o", other, "--format", "csv").err
    assert "it ends in .urdf" in message
    assert other.read_bytes() == urdf
    run_command(2, "export", folder, "-o", other, "--upload")
    run_command(2, "export", folder, "-o", tmp_path / "mine.xacro")


def test_forced_urdf_states_not_accepted(tmp_path, run_command):
    few, sessions = tmp_path / "few.csv", tmp_path / "sessions"
    few.write_text("\n".join(HINGE.read_text().splitlines()[:5]) + "\n")
    run_command(4, "import", few, "--sessions", sessions)
    (folder,) = sessions.iterdir()
    for options, file in (
        (["--format", "urdf"], folder / "arm.urdf"),
        (["--into", folder / "arm.urdf"], folder / "arm_calibrated.urdf"),
    ):
        run_command(4, "export", folder, *options)
        assert not file.exists()
        run_command(4, "export", folder, *options, "--force", f"a test of {file.stem}")
        assert "NOT ACCEPTED" in file.read_text()
        assert f"Used: a test of {file.stem}" in file.read_text()


def test_library_export_of_unaccepted_result_needs_force(tmp_path):
    poses = sarcal.load_poses(HINGE).q_rad[:4]
    result = sarcal.calibrate(
        arm="sarcos_dextrous", fixture="hinge", poses=sarcal.poses_of(q_rad=poses)
    )
    assert not result.accepted
    files = {kind: tmp_path / f"b.{kind}" for kind in ("yaml", "json", "csv", "urdf", "mat")}
    for file in files.values():
        with pytest.raises(sarcal.SessionError, match=r"not accepted: .*force=\"why\""):
            result.export(file)
        with pytest.raises(sarcal.SessionError, match="not accepted"):
            result.export(file, force=" ")
    assert not list(tmp_path.iterdir())
    reason = "=to try the gripper"
    for file in files.values():
        result.export(file, force=reason)
    document = load_parameters(files["yaml"])
    assert document.forced == reason
    assert document.warnings[0].code == "FORCED"
    assert json.loads(files["json"].read_text())["forced"] == reason
    with files["csv"].open(newline="") as rows:
        assert {row["forced"] for row in csv.DictReader(rows)} == {f"'{reason}"}
    assert loadmat(files["mat"], simplify_cells=True)["forced"] == reason
    assert reason in files["urdf"].read_text()
