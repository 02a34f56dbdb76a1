"""An arm and a fixture of one's own: new, check, plan, run, verify, without changing anything but numbers."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import yaml

from operator_app.cli import main
from operator_app.config.arm_file import load_arm
from operator_app.config.procedure_file import load_procedure
from operator_app.session.workflow.opening import Choices
from operator_app.virtual_arms import virtual_arm
from solver.chain.kinematics import forward
from tests.oracles import lbr_iiwa
from tests.oracles.planted_values import planted_values

SEED = 3


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@dataclass(frozen=True)
class Said:
    code: int
    out: str
    err: str


def sarcal(capsys: pytest.CaptureFixture[str], typed: str) -> Said:
    code = main(typed.split())
    return Said(code, *capsys.readouterr())


def made(capsys: pytest.CaptureFixture[str], arm: str) -> None:
    """The arm's file as `arm.yaml`."""
    if arm == "panda":
        assert sarcal(capsys, "new arm --from franka_panda -o arm.yaml").code == 0
        return
    Path("iiwa.urdf").write_text(lbr_iiwa.urdf())
    assert sarcal(capsys, "new arm --urdf iiwa.urdf --name iiwa14 -o arm.yaml").code == 0


POINT = "--hand-point 60,-30,80"
FIXTURES = {
    "hinge": f"--kind hinge {POINT} --hand-direction 1,0.3,-0.4",
    "ball": f"--kind ball {POINT}",
}


def brought_together(capsys: pytest.CaptureFixture[str], arm: str, kind: str) -> dict:
    """Files of arm, fixture and procedure, and what `check` makes of them."""
    made(capsys, arm)
    assert sarcal(capsys, f"new fixture --arm arm.yaml -o it.yaml {FIXTURES[kind]}").code == 0
    assert sarcal(capsys, "new procedure --arm arm.yaml --fixture it.yaml --name go").code == 0
    checked = sarcal(capsys, "check go.yaml arm.yaml it.yaml --json")
    assert checked.code == 0, checked
    (chain,) = json.loads(checked.out)["chains"]
    return chain


def test_the_iiwa_of_its_description_is_the_one_of_its_data_sheet(capsys):
    made(capsys, "iiwa")
    rows = yaml.safe_load(Path("arm.yaml").read_text())["dh"]
    assert [row["s_m"] for row in rows] == pytest.approx(lbr_iiwa.D_M, abs=1e-12)
    assert [row["a_m"] for row in rows] == pytest.approx([0.0] * 7, abs=1e-12)
    assert [abs(row["alpha_deg"]) for row in rows] == pytest.approx(np.abs(lbr_iiwa.ALPHA_DEG))
    q = np.random.default_rng(0).uniform(-2.0, 2.0, 7)
    sheet = forward(q, np.array(lbr_iiwa.D_M), np.zeros(7), np.deg2rad(lbr_iiwa.ALPHA_DEG))
    np.testing.assert_allclose(sheet.p_end, lbr_iiwa.iiwa_hand(q)[:3, 3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(sheet.R_end, lbr_iiwa.iiwa_hand(q)[:3, :3], rtol=0, atol=1e-12)
    joints = yaml.safe_load(Path("arm.yaml").read_text())["joints"]
    assert [j["range_deg"][1] for j in joints] == pytest.approx(lbr_iiwa.RANGE_DEG)
    assert [j["max_speed_deg_per_s"] for j in joints] == pytest.approx(lbr_iiwa.SPEED_DEG_PER_S)


@pytest.mark.parametrize("arm", ["iiwa", "panda"])
def test_geometry_is_pinocchios(capsys, arm):
    made(capsys, arm)
    model = load_arm("arm.yaml")
    q = np.random.default_rng(1).uniform(model.lower_rad, model.upper_rad, (200, 7))
    theta_off, *lengths_and_twists = model.table.stacked()
    frames = forward(q + theta_off, *lengths_and_twists)
    hand = lbr_iiwa.iiwa_hand if arm == "iiwa" else lbr_iiwa.panda_hand
    wanted = np.stack([hand(pose) for pose in q])
    np.testing.assert_allclose(frames.p_end, wanted[:, :3, 3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(frames.R_end, wanted[:, :3, :3], rtol=0, atol=1e-12)


@pytest.mark.sample(1)
@pytest.mark.parametrize(("arm", "kind"), [("iiwa", "hinge"), ("panda", "ball")])
def test_new_files_check_without_another_key(capsys, arm, kind):
    chain = brought_together(capsys, arm, kind)
    # Seven joints and the fixture's own freedoms, less six.
    assert chain["mobility"] == {"hinge": 2, "ball": 4}[kind]
    assert len(chain["drives"]["joints"]) == chain["mobility"]
    assert not chain["seen"]["not_identifiable"]
    assert len(chain["parameters"]) == {"hinge": 7 + 7, "ball": 5 + 6}[kind]


def planted() -> dict[str, float]:
    """What the virtual arm really is, by parameter name, deg and m."""
    procedure = load_procedure("go.yaml")
    chosen = Choices(interface="virtual", scenario="datasheet", seed=SEED)
    return planted_values(virtual_arm(procedure.arm, procedure.fixture, chosen).true_loop())


@pytest.mark.campaign
@pytest.mark.parametrize("kind", FIXTURES)
@pytest.mark.parametrize("arm", ["iiwa", "panda"])
def test_it_is_planned_calibrated_and_verified(capsys, arm, kind):
    chain = brought_together(capsys, arm, kind)
    plan = sarcal(capsys, "plan go.yaml --poses 2 --json")
    assert plan.code == 0, plan.err
    assert json.loads(plan.out)["drives"]["joints"] == chain["drives"]["joints"]
    run = sarcal(capsys, f"run go.yaml --poses 6 --scenario datasheet --seed {SEED} --json")
    assert run.code == 0, run
    found, true = json.loads(run.out), planted()
    for name, value in found["parameters"].items():
        off = abs(value - true[name])
        if "theta_off" in name or "alpha" in name:
            off = min(off, abs(off - 360.0))
        assert off < 4.0 * found["sigma"][name], (name, value, true[name], found["sigma"][name])
    nominal = chain["parameters"]
    assert set(nominal) == set(found["parameters"])
    verified = sarcal(capsys, f"verify {Path(found['session']['poses']).parent} --poses 3")
    assert verified.code == 0, verified
