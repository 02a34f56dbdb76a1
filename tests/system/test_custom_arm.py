"""A user's own arm and fixture: the commands new, check, plan, run and verify, editing nothing but numbers."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from operator_app.config.procedure_file import load_procedure
from operator_app.session.workflow.opening import Choices
from operator_app.virtual_arms import virtual_arm
from tests.oracles import lbr_iiwa
from tests.oracles.planted_values import planted_values

SEED = 3
POINT = "--hand-point 60,-30,80"
FIXTURES = {
    "hinge": f"--kind hinge {POINT} --hand-direction 1,0.3,-0.4",
    "ball": f"--kind ball {POINT}",
}


@pytest.fixture
def accepted(run_command, tmp_path, monkeypatch):
    """Run a command line in an empty folder; its exit code must be 0."""
    monkeypatch.chdir(tmp_path)
    return lambda line: run_command(0, *line.split())


@pytest.fixture
def arm_file(accepted, arm):
    if arm == "panda":
        accepted("new arm --from franka_panda -o arm.yaml")
    else:
        Path("iiwa.urdf").write_text(lbr_iiwa.urdf())
        accepted("new arm --urdf iiwa.urdf --name iiwa14 -o arm.yaml")


@pytest.fixture
def checked_chain(arm_file, accepted, kind):
    """Write files of arm, fixture and procedure; return the chain that `check` reports."""
    accepted(f"new fixture --arm arm.yaml -o it.yaml {FIXTURES[kind]}")
    accepted("new procedure --arm arm.yaml --fixture it.yaml --name go")
    (chain,) = accepted("check go.yaml arm.yaml it.yaml --json").json["chains"]
    return chain


@pytest.mark.parametrize("arm", ["iiwa"])
def test_iiwa_of_urdf_agrees_with_data_sheet(arm_file):
    document = yaml.safe_load(Path("arm.yaml").read_text())
    rows, joints = document["dh"], document["joints"]
    assert [row["s_m"] for row in rows] == pytest.approx(lbr_iiwa.D_M, abs=1e-12)
    assert [row["a_m"] for row in rows] == pytest.approx([0.0] * 7, abs=1e-12)
    assert [abs(row["alpha_deg"]) for row in rows] == pytest.approx(np.abs(lbr_iiwa.ALPHA_DEG))
    assert [j["range_deg"][1] for j in joints] == pytest.approx(lbr_iiwa.RANGE_DEG)
    assert [j["max_speed_deg_per_s"] for j in joints] == pytest.approx(lbr_iiwa.SPEED_DEG_PER_S)


@pytest.mark.campaign
@pytest.mark.parametrize("kind", FIXTURES)
@pytest.mark.parametrize("arm", ["iiwa", "panda"])
def test_custom_arm_is_planned_calibrated_and_verified(accepted, checked_chain):
    plan = accepted("plan go.yaml --poses 2 --json").json
    assert plan["drives"]["joints"] == checked_chain["drives"]["joints"]
    result = accepted(f"run go.yaml --poses 6 --scenario datasheet --seed {SEED} --json").json
    procedure = load_procedure("go.yaml")
    choices = Choices(interface="virtual", scenario="datasheet", seed=SEED)
    true = planted_values(virtual_arm(procedure.arm, procedure.fixture, choices).true_loop())
    for name, value in result["parameters"].items():
        error = abs(value - true[name])
        if "theta_off" in name or "alpha" in name:
            error = min(error, abs(error - 360.0))
        assert error < 4.0 * result["sigma"][name], (name, value, true[name], result["sigma"][name])
    assert set(checked_chain["parameters"]) == set(result["parameters"])
    accepted(f"verify {Path(result['session']['poses']).parent} --poses 3")
