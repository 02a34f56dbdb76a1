"""An arm and a fixture of one's own: new, check, plan, run, verify, without changing anything but numbers."""

from pathlib import Path

import numpy as np
import pytest
import yaml

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


@pytest.fixture
def accepted(ends_with):
    """Type a command that ends with exit code 0."""
    return lambda typed: ends_with(0, *typed.split())


@pytest.fixture
def made(accepted, arm):
    """The file `arm.yaml` of this arm."""
    if arm == "panda":
        accepted("new arm --from franka_panda -o arm.yaml")
    else:
        Path("iiwa.urdf").write_text(lbr_iiwa.urdf())
        accepted("new arm --urdf iiwa.urdf --name iiwa14 -o arm.yaml")


POINT = "--hand-point 60,-30,80"
FIXTURES = {
    "hinge": f"--kind hinge {POINT} --hand-direction 1,0.3,-0.4",
    "ball": f"--kind ball {POINT}",
}


@pytest.fixture
def chain(made, accepted, kind):
    """Files of arm, fixture and procedure, and what `check` makes of them."""
    accepted(f"new fixture --arm arm.yaml -o it.yaml {FIXTURES[kind]}")
    accepted("new procedure --arm arm.yaml --fixture it.yaml --name go")
    (found,) = accepted("check go.yaml arm.yaml it.yaml --json").json["chains"]
    return found


@pytest.mark.parametrize("arm", ["iiwa"])
def test_the_iiwa_of_its_description_is_the_one_of_its_data_sheet(made):
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
def test_geometry_is_pinocchios(made, arm):
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
def test_new_files_check_without_another_key(chain, kind):
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
def test_it_is_planned_calibrated_and_verified(accepted, chain):
    plan = accepted("plan go.yaml --poses 2 --json").json
    assert plan["drives"]["joints"] == chain["drives"]["joints"]
    run = f"run go.yaml --poses 6 --scenario datasheet --seed {SEED} --json"
    found, true = accepted(run).json, planted()
    for name, value in found["parameters"].items():
        off = abs(value - true[name])
        if "theta_off" in name or "alpha" in name:
            off = min(off, abs(off - 360.0))
        assert off < 4.0 * found["sigma"][name], (name, value, true[name], found["sigma"][name])
    nominal = chain["parameters"]
    assert set(nominal) == set(found["parameters"])
    accepted(f"verify {Path(found['session']['poses']).parent} --poses 3")
