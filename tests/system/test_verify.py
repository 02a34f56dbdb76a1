"""`sarcal verify`: a calibration holds on new poses, and not after a step change of a joint."""

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest

from operator_app.cli import main
from operator_app.session.store.folders import read_session
from tests.oracles.recorded import cached_folder


@pytest.fixture(scope="module")
def sessions(tmp_path_factory):
    folder = tmp_path_factory.mktemp("verify") / "sessions"
    shutil.copytree(cached_folder(hinge_session), folder)
    return folder


def hinge_session(folder: Path) -> None:
    """Run one session of the hinge."""
    assert main(["run", "hinge", "--poses", "15", "--sessions", str(folder)]) == 0


def test_calibration_holds_on_new_poses_of_the_arm(sessions, run_command):
    options = ["--sessions", str(sessions), "--poses", "6", "--json"]
    (session,) = sessions.iterdir()
    result = run_command(0, "verify", session.name, *options).json
    assert result["verdict"] == "holds"
    assert result["poses"] == 6
    assert result["odd_poses"] == []
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
    with (session / "poses.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    # Without the 0.002 deg they would be refused as the calibration's own.
    for k, row in enumerate(rows):
        row["theta3_deg"] = repr(float(row["theta3_deg"]) + (0.5 if k < 2 else 0.002))
    file = tmp_path / "new.csv"

    def write() -> None:
        with file.open("w", newline="") as stream:
            writer = csv.DictWriter(stream, rows[0].keys())
            writer.writeheader()
            writer.writerows(rows)

    write()
    options = ["--sessions", str(sessions), "--json"]
    result = run_command(4, "verify", session.name, file, *options).json
    assert result["verdict"] == "does not hold"
    assert sorted(result["odd_poses"]) == ["1", "2"]
    answer = run_command(4, "verify", session.name, file, "--sessions", sessions)
    assert answer.out.startswith(f"DOES NOT HOLD: 2 of {len(rows)} new poses deviate by more")
    assert "check pose" in answer.out
    assert answer.err == ""
    for row in rows:
        row |= {f"theta{j}_deg": repr(float(row[f"theta{j}_deg"]) / 57.29578) for j in range(1, 8)}
    write()
    errors = run_command(4, "verify", session.name, file, "--sessions", sessions).err
    assert f"sarcal: {file}: no joint angle" in errors
