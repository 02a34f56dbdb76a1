"""One session, several mountings of its fixture: shared offsets, entries of each, and no death loses a pose.

The virtual arm's truth in every placement is asked of the controller's side.
"""

import csv
import re
from pathlib import Path

import numpy as np
import pytest

from operator_app.config.parameters_file import load_parameters
from operator_app.session.store.folders import read_session
from operator_app.session.store.journal import read_journal
from operator_app.session.workflow.opening import Choices, begin
from operator_app.virtual_arms import virtual_arm
from tests.oracles.own_process import start, wait_for_poses
from tests.oracles.planted_values import planted_values

POSES = 10


def killed_after(folder: Path, poses: int, *arguments: str) -> None:
    """Run a program and kill it as soon as its session has so many poses."""
    process = start(folder, *arguments)
    wait_for_poses(folder / "sessions", poses, process)
    process.kill()
    process.communicate()


def truth(placement: int) -> dict[str, float]:
    procedure = begin("hinge", Choices(), root=Path()).procedure
    arm = virtual_arm(procedure.arm, procedure.fixture, Choices(), placement)
    return planted_values(arm.true_loop())


@pytest.mark.campaign
def test_two_placements_are_one_calibration_though_killed_in_either(tmp_path, ends_with):
    sessions = ["--sessions", str(tmp_path / "sessions")]
    new = ["run", "hinge", "--placements", "2", "--poses", str(POSES)]
    killed_after(tmp_path, 4, *new)
    killed_after(tmp_path, POSES + 4, "run", "--resume", "latest")
    (folder,) = (tmp_path / "sessions").iterdir()
    before = [e.data for e in read_journal(folder).events if e.name == "pose"]
    found = ends_with(0, "run", "--resume", "latest", *sessions, "--json").json
    assert found["verdict"] in ("accepted", "accepted_with_warnings")
    assert found["poses"] == 2 * POSES

    # Nothing was taken twice or lost; each pose says in which placement it was taken.
    poses = [e.data for e in read_journal(folder).events if e.name == "pose"]
    assert poses[: len(before)] == before
    with (folder / "poses.csv").open(newline="") as file:
        assert [row["placement"] for row in csv.DictReader(file)] == ["1"] * POSES + ["2"] * POSES

    # One arm, two mountings: every value within 4 sigma of what was planted, which differ between them.
    planted = {k: truth(k) for k in (1, 2)}
    assert planted[1]["theta_off_3"] == planted[2]["theta_off_3"]
    assert abs(planted[1]["s_0"] - planted[2]["s_0"]) > 0.0005
    own = {name for name in found["parameters"] if "[" in name}
    assert {re.sub(r"\[.\]", "", name) for name in own} == {
        "theta_off_1", "a_0", "s_0", "alpha_0", "s_1", "theta_off_7", "a_7", "s_7", "alpha_7",
    }  # fmt: skip
    for name, value in found["parameters"].items():
        plain, _, number = name.rstrip("]").partition("[")
        wanted = planted[int(number or 1)][plain]
        assert abs(value - wanted) < 4.0 * found["sigma"][name], name

    # The file says what is mounted now.
    document = load_parameters(folder / "parameters.yaml")
    here = found["parameters"]
    assert document.table.a_m[0] == pytest.approx(here["a_0[2]"], abs=1e-15)
    assert np.rad2deg(document.theta_off_rad[0]) == pytest.approx(here["theta_off_1[2]"])
    assert "PLACEMENTS" in {w.code for w in document.warnings}

    # And so do new poses: on the arm in the second placement, and as a file of the first.
    verified = ends_with(0, "verify", "latest", "--poses", "3", *sessions, "--json").json
    assert verified["verdict"] == "holds"
    state = read_session(folder).state
    assert state is not None
    assert [r.placement for r in state.readings if r.kind == "verification"] == [2, 2, 2]
    rows = list(csv.reader((folder / "poses.csv").read_text().splitlines()))
    few = tmp_path / "few.csv"
    for placement, code in (("1", 0), ("2", 4), ("3", 2)):
        # Poses of the first placement, as if taken again (0.002 deg), said to be of each.
        few.write_text(
            "\n".join(
                ",".join(r if k == 0 else [placement, r[1], repr(float(r[2]) + 0.002), *r[3:]])
                for k, r in enumerate(rows[:5])
            )
        )
        ends_with(code, "verify", "latest", few, *sessions)
