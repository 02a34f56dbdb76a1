"""One session with several placements of its fixture: shared offsets, entries of each, no pose lost by a kill."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest

from operator_app.config.parameters_file import load_parameters
from operator_app.session.store.folders import read_session
from operator_app.session.workflow.opening import Choices, begin
from operator_app.virtual_arms import virtual_arm
from tests.oracles.journal_events import event_data
from tests.oracles.own_process import start, wait_for_poses
from tests.oracles.planted_values import planted_values

POSES = 10


def kill_at_pose(folder: Path, poses: int, *arguments: str) -> None:
    """Run a program and kill it when its journal has this many poses."""
    process = start(folder, *arguments)
    wait_for_poses(folder / "sessions", poses, process)
    process.kill()
    process.communicate()


def true_values(placement: int) -> dict[str, float]:
    procedure = begin("hinge", Choices(), root=Path()).procedure
    arm = virtual_arm(procedure.arm, procedure.fixture, Choices(), placement)
    return planted_values(arm.true_loop())


@pytest.mark.campaign
def test_two_placements_are_one_calibration_despite_kills(tmp_path, run_command):
    sessions = ["--sessions", str(tmp_path / "sessions")]
    kill_at_pose(tmp_path, 4, "run", "hinge", "--placements", "2", "--poses", str(POSES))
    kill_at_pose(tmp_path, POSES + 4, "run", "--resume", "latest")
    (folder,) = (tmp_path / "sessions").iterdir()
    poses_at_kill = event_data(folder, "pose")
    result = run_command(0, "run", "--resume", "latest", *sessions, "--json").json
    estimates = result["parameters"]
    assert result["verdict"] in ("accepted", "accepted_with_warnings")
    assert result["poses"] == 2 * POSES

    assert event_data(folder, "pose")[: len(poses_at_kill)] == poses_at_kill
    rows = list(csv.reader((folder / "poses.csv").read_text().splitlines()))
    column = [row[rows[0].index("placement")] for row in rows[1:]]
    assert column == ["1"] * POSES + ["2"] * POSES

    # The true values of one arm and two placements, of which each has its own hinge.
    true = {k: true_values(k) for k in (1, 2)}
    assert true[1]["theta_off_3"] == true[2]["theta_off_3"]
    assert abs(true[1]["s_0"] - true[2]["s_0"]) > 0.0005
    assert {re.sub(r"\[.\]", "", name) for name in estimates if "[" in name} == {
        "theta_off_1", "a_0", "s_0", "alpha_0", "s_1", "theta_off_7", "a_7", "s_7", "alpha_7",
    }  # fmt: skip
    for name, value in estimates.items():
        plain, _, placement = name.rstrip("]").partition("[")
        error = abs(value - true[int(placement or 1)][plain])
        assert error < 4.0 * result["sigma"][name], name

    # The parameters file and new poses are of the present placement.
    document = load_parameters(folder / "parameters.yaml")
    assert document.table.a_m[0] == pytest.approx(estimates["a_0[2]"], abs=1e-15)
    assert np.rad2deg(document.theta_off_rad[0]) == pytest.approx(estimates["theta_off_1[2]"])
    assert "PLACEMENTS" in {w.code for w in document.warnings}
    verified = run_command(0, "verify", "latest", "--poses", "3", *sessions, "--json").json
    assert verified["verdict"] == "holds"
    state = read_session(folder).state
    assert [r.placement for r in state.readings if r.kind == "verification"] == [2, 2, 2]

    # A file with poses of the first placement, measured again (0.002 deg), under each number.
    file = tmp_path / "few.csv"
    for placement, code in (("1", 0), ("2", 4), ("3", 2)):
        poses = [[placement, r[1], repr(float(r[2]) + 0.002), *r[3:]] for r in rows[1:5]]
        file.write_text("\n".join(map(",".join, [rows[0], *poses])))
        run_command(code, "verify", "latest", file, *sessions)
