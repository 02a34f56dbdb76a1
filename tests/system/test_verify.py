"""`sarcal verify`: a sound calibration holds on poses it has not seen, a spoilt one does not."""

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest

from operator_app.cli import main
from operator_app.session.store.folders import read_session
from tests.oracles.recorded import recorded_folder


@pytest.fixture(scope="module")
def sessions(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sessions") / "made"
    shutil.copytree(recorded_folder(hinge_session), folder)
    return folder


def hinge_session(folder: Path) -> None:
    """Run one session of the hinge."""
    assert main(["run", "hinge", "--poses", "15", "--sessions", str(folder)]) == 0


def test_new_poses_on_the_arm_confirm_the_calibration(sessions, ends_with):
    options = ["--sessions", str(sessions), "--poses", "6", "--json"]
    (session,) = sessions.iterdir()
    found = ends_with(0, "verify", session.name, *options).json
    assert found["verdict"] == "holds"
    assert found["poses"] == 6
    assert found["odd_poses"] == []
    assert found["sigma_pos_mm"]["rms"] < 0.2 * found["nominal"]["sigma_pos_mm"]["rms"]

    # They are in the journal of the session, readings and all, and no part of its calibration.
    assert list(sessions.iterdir()) == [session]
    state = read_session(session).state
    assert state is not None
    assert [r.kind for r in state.readings] == ["return", *["verification"] * 6]
    assert len(state.used_poses) == 15
    apart = [
        np.abs(r.mean_rad - p.mean_rad).max() for r in state.readings[1:] for p in state.used_poses
    ]
    assert min(apart) > np.deg2rad(0.5)


@pytest.mark.campaign
def test_a_joint_that_slipped_since_is_noticed_and_the_poses_named(sessions, tmp_path, ends_with):
    (session,) = sessions.iterdir()
    with (session / "poses.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    # A pose that is taken again never reads the very same; the calibration's own are refused.
    for k, row in enumerate(rows):
        row["theta3_deg"] = repr(float(row["theta3_deg"]) + (0.5 if k < 2 else 0.002))
    changed = tmp_path / "new.csv"

    def write() -> None:
        with changed.open("w", newline="") as file:
            writer = csv.DictWriter(file, rows[0].keys())
            writer.writeheader()
            writer.writerows(rows)

    write()
    options = ["--sessions", str(sessions), "--json"]
    found = ends_with(4, "verify", session.name, changed, *options).json
    assert found["verdict"] == "does not hold"
    assert sorted(found["odd_poses"]) == ["1", "2"]
    said = ends_with(4, "verify", session.name, changed, "--sessions", sessions)
    assert said.out.startswith(f"DOES NOT HOLD: 2 of {len(rows)} new poses deviate by more")
    assert "check pose" in said.out
    assert said.err == ""
    for row in rows:
        row |= {f"theta{j}_deg": repr(float(row[f"theta{j}_deg"]) / 57.29578) for j in range(1, 8)}
    write()
    said = ends_with(4, "verify", session.name, changed, "--sessions", sessions).err
    assert f"sarcal: {changed}: no joint angle" in said


def test_a_session_without_poses_has_nothing_to_verify(tmp_path, ends_with):
    assert "no session" in ends_with(2, "verify", "latest", "--sessions", tmp_path).err
