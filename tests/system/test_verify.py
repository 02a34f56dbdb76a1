"""`sarcal verify`: a calibration holds on new poses, and not after a step change of a joint."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from operator_app.cli import main
from operator_app.config.poses_file import load_poses, save_poses
from operator_app.session.store.folders import read_session
from tests.oracles.as_shipped import displaced
from tests.oracles.recorded import cached_folder


@pytest.fixture(scope="module")
def sessions(tmp_path_factory):
    folder = tmp_path_factory.mktemp("verify") / "sessions"
    shutil.copytree(cached_folder(hinge_session), folder)
    return folder


def hinge_session(folder: Path) -> None:
    assert main(["run", "hinge", "--poses", "15", "--sessions", str(folder)]) == 0


def test_calibration_holds_on_new_poses_of_the_arm(sessions, run_command):
    options = ["--sessions", str(sessions), "--poses", "6", "--json"]
    (session,) = sessions.iterdir()
    result = run_command(0, "verify", session.name, *options).json
    assert (result["verdict"], result["poses"], result["odd_poses"]) == ("holds", 6, [])
    assert result["sigma_pos_mm"]["rms"] < 0.2 * result["nominal"]["sigma_pos_mm"]["rms"]

    # The journal of the session has them; its calibration does not use them.
    assert list(sessions.iterdir()) == [session]
    state = read_session(session).state
    assert [r.kind for r in state.readings] == ["return", *["verification"] * 6]
    assert len(state.used_poses) == 15
    distances_rad = [
        np.abs(r.mean_rad - p.mean_rad).max() for r in state.readings[1:] for p in state.used_poses
    ]
    assert min(distances_rad) > np.deg2rad(0.5)


@pytest.mark.campaign
def test_poses_after_a_step_change_of_a_joint_are_named(sessions, tmp_path, run_command):
    (session,) = sessions.iterdir()
    poses, file = load_poses(session / "poses.csv").poses, tmp_path / "new.csv"
    # Without the 0.002 deg they would be refused as the calibration's own.
    stepped = displaced(displaced(poses, np.s_[:, 2], 0.002), np.s_[:2, 2], 0.5)
    save_poses(file, stepped)
    command = ("verify", session.name, file, "--sessions", sessions)
    result = run_command(4, *command, "--json").json
    assert result["verdict"] == "does not hold"
    assert sorted(result["odd_poses"]) == ["1", "2"]
    answer = run_command(4, *command)
    assert answer.out.startswith(f"DOES NOT HOLD: 2 of {len(poses)} new poses deviate by more")
    assert "check pose" in answer.out
    assert answer.err == ""
    save_poses(file, replace(stepped, q_rad=np.deg2rad(stepped.q_rad)))
    refusal = run_command(2, *command).err
    assert f"sarcal: {file}: no joint angle" in refusal
    assert "in range if taken as radians" in refusal
