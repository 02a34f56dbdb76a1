"""`import sarcal`: arrays in, the figures of the command out, files that can be read again."""

import copy
import doctest
import importlib
import pickle
import pkgutil
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import sarcal

from operator_app.cli import main
from operator_app.config.poses_file import FileWarning
from operator_app.session.store.journal import Journal
from solver.chain.parameters import DhKind
from tests.oracles.makers_chains import flange

HINGE = Path(__file__).parents[2] / "data/hinge"
POSES, QUANTISED = HINGE / "hinge_exact.csv", HINGE / "hinge_quantised.csv"
MODULES = ["sarcal", *(f"sarcal.{m.name}" for m in pkgutil.iter_modules(sarcal.__path__))]


@pytest.mark.parametrize("name", MODULES)
def test_docstring_examples_run(name):
    failed, attempted = doctest.testmod(importlib.import_module(name), report=True)
    assert not failed
    documented = {"sarcal", "sarcal.calibrating", "sarcal.planning",
                  "sarcal.result", "sarcal.tables", "sarcal.poses", "sarcal.machines"}  # fmt: skip
    assert attempted or name not in documented


def test_result_agrees_with_the_command(result, run_command):
    document = run_command(0, "solve", POSES, "--json").json
    assert result.to_json() == document
    for key, value in result.values.items():
        name, _, unit = key.rpartition("_")
        assert value == pytest.approx(
            document["parameters"][name] * (1.0 if unit == "deg" else 1e3)
        )
    assert set(result.sigmas) == set(result.intervals_95) == set(result.values)
    listed = document["interval_95"]
    low, high = result.intervals_95["theta_off_3_deg"]
    assert [low, high] == pytest.approx(listed["theta_off_3"])
    assert low < result.values["theta_off_3_deg"] < high
    assert result.intervals_95["s_1_mm"] == pytest.approx([1e3 * v for v in listed["s_1"]])
    sigma_m = result.tip_sigma(result.poses.q_rad)
    rms = 1e3 * np.sqrt((sigma_m**2).mean())
    assert rms == pytest.approx(document["best_table_tool_sigma_mm"], rel=0.2)
    assert result.tip_sigma(result.poses.q_rad[0]).shape == ()
    assert result.verdict == document["verdict"]
    assert run_command(0, "solve", POSES).out.rstrip("\n") == result.text


def test_the_best_table_has_the_base_frame_of_the_arm_file(result, approve):
    document, rows = result.to_json(), result.arm._model.table.stacked()
    ground = [name for name, side in document["side"].items() if side == "ground"]
    best = document["best_table"]
    assert {"s_1", "theta_off_1"} <= {*ground} & {*best}
    assert best["s_1"] == rows[DhKind.S, 0]
    assert best["theta_off_1"] == pytest.approx(np.rad2deg(rows[DhKind.THETA_OFF, 0]))
    approve(result._facts.table("best_table").note)


def test_arrays_file_and_data_frame_give_the_same_poses(result):
    poses = sarcal.load_poses(POSES)
    in_deg = sarcal.poses_of(q_deg=poses.q_deg)
    in_rad = sarcal.poses_of(q_rad=poses.q_rad)
    np.testing.assert_allclose(in_deg.q_rad, in_rad.q_rad, rtol=0, atol=1e-14)
    # As in pandas and polars: named columns.
    columns = {f"theta{j}_deg": list(poses.q_deg[:, j - 1]) for j in range(1, 8)}
    from_frame = sarcal.load_poses(_Frame(columns | {"samples": [32.0] * len(poses)}))
    with pytest.raises(sarcal.ConfigError, match="0: unknown column"):
        sarcal.load_poses(_Frame({0: [1.0]}))
    np.testing.assert_allclose(from_frame.q_rad, poses.q_rad, rtol=0, atol=1e-14)
    assert "in radians" in sarcal.poses_of(q_deg=poses.q_rad)._warnings[0].text
    repeated = sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=in_rad)
    assert dict(repeated.values) == pytest.approx(dict(result.values), abs=1e-6)
    doubled = sarcal.poses_of(q_rad=np.vstack((poses.q_rad, poses.q_rad[:3])))
    more = sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=doubled)
    assert more.figure("rvdt").svg.count("pose 3: deviation") == 2
    with pytest.raises(TypeError, match="does not state its unit"):
        sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=poses.q_rad)


class _Frame(dict[object, list[float]]):
    columns = property(list)


def test_pandas_data_frames_are_accepted_and_returned(result):
    pd = pytest.importorskip("pandas")
    poses = sarcal.load_poses(POSES)
    frame = pd.DataFrame(poses.q_deg, columns=[f"theta{j}_deg" for j in range(1, 8)])
    np.testing.assert_array_equal(sarcal.load_poses(frame).q_rad, np.deg2rad(poses.q_deg))
    assert list(result.table().to_frame().columns) == list(result.table().columns)


def test_notebook_representations(result):
    for value in (result, result.arm, result.fixture, result.poses, result.table()):
        assert re.fullmatch(".{1,99}", repr(value))
    html = ET.fromstring(f"<body>{result._repr_html_()}</body>")  # noqa: S314 - our own
    assert "theta_off_1" in html.itertext()
    with pytest.raises(KeyError, match="there are parameters, "):
        result.table("nonsense")


def test_tool_line_of_a_hinge_is_the_same_in_all_poses(result):
    """A hinge holds one line of the tool, in any frame of the base."""
    T = result.fk(result.poses.q_rad)
    axes, points = T[:, :3, 2], T[:, :3, 3]
    assert np.abs(axes - axes[0]).max() < 2e-3
    off = points - points[0]
    assert np.linalg.norm(off - (off @ axes[0])[:, None] * axes[0], axis=1).max() < 2e-3
    first = result.fk(result.poses.q_rad[0])
    np.testing.assert_allclose(first, T[0], rtol=0, atol=1e-15)


def test_tool_point_of_a_ball_is_in_its_sockets(ball):
    T = ball.fk(ball.poses.q_rad)
    for placement in (1, 4):
        points = T[ball.poses.placement == placement, :3, 3]
        centre = [ball.values[f"ground_{axis}[{placement}]_mm"] / 1e3 for axis in "xyz"]
        assert np.linalg.norm(points - centre, axis=1).mean() < 1.5e-3
    assert ball.tip_sigma(ball.poses.q_rad).max() < 0.01


def test_saved_result_is_a_session_and_is_loaded_unchanged(result, tmp_path, run_command):
    folder, q_rad = result.save(tmp_path / "sessions/mine"), result.poses.q_rad
    assert {p.name for p in folder.iterdir()} == {
        "journal.jsonl", "parameters.yaml", "poses.csv", "report.html",
    }  # fmt: skip
    document = run_command(0, "report", folder, "--json").json
    assert document["parameters"] == result.to_json()["parameters"]
    run_command(0, "compare", folder, folder / "parameters.yaml")
    run_command(0, "verify", folder, QUANTISED)
    run_command(0, "export", folder, "-o", tmp_path / "p.yaml")
    np.testing.assert_array_equal(sarcal.load_poses(folder / "poses.csv").q_rad, q_rad)
    assert sarcal.compare(result, folder).drifted == ()
    reloaded = sarcal.load_result(folder)
    assert reloaded.to_json() == result.to_json()
    assert repr(reloaded) == repr(result)
    np.testing.assert_array_equal(reloaded.fk(q_rad), result.fk(q_rad))
    doubted = replace(
        sarcal.load_poses(QUANTISED), _warnings=(FileWarning(code="C", text="doubt"),)
    )
    assert sarcal.verify(reloaded, doubted).holds
    assert str(sarcal.verify(reloaded, doubted)).endswith("\n! doubt")
    with pytest.raises(ValueError, match="these are poses that the calibration was made from"):
        sarcal.verify(reloaded, folder / "poses.csv")
    measured = sarcal.poses_of(q_rad=q_rad[:4] + 5e-4, endpoint_m=np.zeros((4, 3)))
    with pytest.raises(ValueError, match="measured endpoints, which a hinge fixture does not use"):
        sarcal.verify(reloaded, measured)
    assert sarcal.compare(reloaded, folder).to_json()["verdict"].startswith("same poses")
    with pytest.raises(sarcal.SessionError, match="Copy that folder"):
        reloaded.save(tmp_path / "other")
    with pytest.raises(sarcal.SessionError, match="journal"):
        sarcal.load_result(tmp_path / "other")
    with pytest.raises(TypeError, match="session=3: give the folder"):
        sarcal.load_result(3)


def test_saving_again_replaces_only_our_files_of_the_same_data(result, tmp_path, run_command):
    folder = result.save(tmp_path / "mine")
    assert main(["export", str(folder), "--format", "urdf"]) == 0
    (folder / "my_notes.txt").write_text("mine")
    assert result.save(folder) == folder
    # The outdated export is removed, the file of another origin stays.
    assert {p.name for p in folder.iterdir()} == {
        "journal.jsonl", "parameters.yaml", "poses.csv", "report.html", "my_notes.txt",
    }  # fmt: skip
    before = (folder / "journal.jsonl").read_bytes()
    other = sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=QUANTISED)
    with pytest.raises(sarcal.SessionError, match=r"of other data \(\d+ poses\).*overwrite=True"):
        other.save(folder)
    assert (folder / "journal.jsonl").read_bytes() == before
    other.save(folder, overwrite=True)
    parameters = run_command(0, "report", folder, "--json").json["parameters"]
    assert parameters == other.to_json()["parameters"]


def test_outdated_file_that_cannot_be_removed_is_named(result, tmp_path):
    folder = result.save(tmp_path / "mine")
    before = (folder / "journal.jsonl").read_bytes()
    (folder / "poses.csv").unlink()
    (folder / "poses.csv").mkdir()
    with pytest.raises(OSError, match=r"poses\.csv"):
        result.save(folder)
    assert (folder / "journal.jsonl").read_bytes() == before


def test_captured_or_edited_sessions_are_not_overwritten(result, tmp_path, monkeypatch):
    """A session of an arm, one with notes, one in use, and a damaged one."""
    monkeypatch.chdir(tmp_path)
    arm = Journal.create(Path("arm"))
    arm.append("opened", {"sources": {}, "settings": {}})
    with pytest.raises(sarcal.SessionError, match="in use"):
        result.save("arm", overwrite=True)
    arm.close()
    noted = Journal.resume(result.save("noted"))
    noted.append("pose_noted", {"number": 3, "text": "a truck went by"})
    noted.close()
    Path("damaged").mkdir()
    lines = Path("noted/journal.jsonl").read_bytes().splitlines(keepends=True)
    Path("damaged/journal.jsonl").write_bytes(b"".join([lines[0], *lines[2:]]))
    for folder, message in (("arm", "not replaced"), ("noted", "edited"), ("damaged", "damaged")):
        before = Path(folder, "journal.jsonl").read_bytes()
        with pytest.raises(sarcal.SessionError, match=message):
            result.save(folder, overwrite=True)
        assert Path(folder, "journal.jsonl").read_bytes() == before


def test_calibration_recovers_the_simulated_truth():
    z = []
    for seed in range(3):
        simulation = sarcal.simulate(arm="sarcos_dextrous", fixture="hinge", poses=40, seed=seed)
        assert sarcal.load_poses(simulation, joint_count=7) is simulation.poses
        result = sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=simulation.poses)
        assert result.accepted, result.reasons
        z += [(v - simulation.truth[k]) / result.sigmas[k] for k, v in result.values.items()]
    assert np.mean(np.abs(z) < 3.0) > 0.95
    same = sarcal.simulate(arm="sarcos_dextrous", fixture="hinge", poses=40, seed=2)
    np.testing.assert_array_equal(same.poses.q_rad, simulation.poses.q_rad)


@pytest.mark.campaign
def test_intervals_cover_in_a_rigid_mount(tmp_path):
    """The poses hardly determine the lengths, and neither play nor sag of the file is there."""
    packaged = resources.files("operator_app") / "data/arms/sarcos_dextrous.yaml"
    arm = tmp_path / "arm.yaml"
    arm.write_text(packaged.read_text().replace("theta_off_4, ", ""))
    z = []
    for seed in range(12):
        made = sarcal.simulate(arm=arm, fixture="rigid", poses=40, seed=seed)
        result = sarcal.calibrate(arm=arm, fixture="rigid", poses=made.poses)
        z += [(v - made.truth[k]) / result.sigmas[k] for k, v in result.values.items()]
    assert np.mean(np.abs(z) < 1.96) > 0.9


def test_fk_of_an_arm_agrees_with_its_maker():
    arm = sarcal.load_arm("franka_panda")
    q = np.random.default_rng(1).uniform(arm.lower_rad, arm.upper_rad, (20, 7))
    expected = [flange("franka_panda", angles) for angles in q]
    np.testing.assert_allclose(arm.fk(q), expected, rtol=0, atol=1e-9)
    with pytest.raises(ValueError, match=r"np\.deg2rad"):
        arm.fk(np.rad2deg(q))


def test_arms_and_fixtures_of_one_file_are_equal():
    for load, name, other in (
        (sarcal.load_arm, "ur5e", "ur10e"), (sarcal.load_fixture, "ball", "hinge"),
    ):  # fmt: skip
        assert load(name) == load(name)
        assert load(name) in [load(other), load(name)]
        assert len({load(name), load(name), load(other)}) == 2


def test_simulations_and_results_are_pickled_and_copied(result):
    made = sarcal.simulate(arm="sarcos_dextrous", fixture="hinge", poses=4, seed=0)
    for again in (pickle.loads(pickle.dumps(made)), copy.deepcopy(made)):  # noqa: S301 - our own
        assert again.truth == made.truth
        np.testing.assert_array_equal(again.poses.q_rad, made.poses.q_rad)
    plan = sarcal.plan(arm=result.arm, fixture="hinge", poses=3, drive_joints=[1, 5])
    assert len({made, copy.deepcopy(made), plan, sarcal.compare(result, result)}) == 4
    for again in (pickle.loads(pickle.dumps(result)), copy.deepcopy(result)):  # noqa: S301 - our own
        assert again.to_json() == result.to_json()


def test_a_changed_json_object_does_not_change_the_result(result):
    document = result.to_json()
    document["parameters"].clear()
    document["verdict"] = "changed"
    assert result.verdict != "changed"
    assert result.to_json()["parameters"]


def test_no_readings_have_no_tip_and_no_sigma(result):
    none = np.zeros((0, 7))
    assert result.fk(none).shape == (0, 4, 4)
    assert result.tip_sigma(none).shape == (0,)
