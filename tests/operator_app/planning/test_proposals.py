"""Proposed home poses: all joints move there, and a mounted hinge fits, by pinocchio's chain."""

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml

from tests.oracles import lbr_iiwa
from tests.oracles.makers_chains import flange

TOOL_M = np.array([0.06, 0.0, 0.08])
AXIS = np.array([1.0, 0.3, -0.2]) / np.linalg.norm([1.0, 0.3, -0.2])
MOUNTED_DEG = (20.0, 50.0, -20.0, -80.0, 30.0, 70.0, 10.0)
"""Joint angles at which the hinge was mounted, unknown to the commands."""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("iiwa.urdf").write_text(lbr_iiwa.urdf())
    return tmp_path


def home_deg():
    return yaml.safe_load(Path("iiwa14.yaml").read_text())["home_deg"]


def set_home(line):
    file = Path("iiwa14.yaml")
    file.write_text(re.sub(r"home_deg: .*", line, file.read_text()))


def hinge_pin(q_deg: list[float] | tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """A point and the direction of the hinge's pin in the base."""
    T = flange("kuka_iiwa14", np.deg2rad(q_deg))
    return T[:3, :3] @ TOOL_M + T[:3, 3], T[:3, :3] @ AXIS


def least_motion(q_deg: list[float]) -> float:
    """Motion of the slowest joint in a hinge, by pinocchio's Jacobian; 0 in a singular pose."""
    model = pin.buildModelFromXML(lbr_iiwa.urdf())
    data, q = model.createData(), np.deg2rad(q_deg)
    frame = model.getFrameId("flange")
    J = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL)
    hinge = np.concatenate((np.cross(TOOL_M, AXIS), AXIS))
    _, size, Vt = np.linalg.svd(np.column_stack((J, hinge)))
    return float(size[-1] * np.linalg.norm(Vt[6:], axis=0)[:7].min())


def test_stretched_urdf_gets_a_nonsingular_home(folder, run_command):
    output = run_command(0, "new", "arm", "--urdf", "iiwa.urdf", "--name", "iiwa14").out
    assert "Home        bent" in output
    assert least_motion([0.0] * 7) == pytest.approx(0.0, abs=1e-9)
    assert least_motion(home_deg()) > 0.01
    assert (np.abs(home_deg()) < 0.7 * np.array(lbr_iiwa.RANGE_DEG)).all()


@pytest.mark.campaign
def test_proposed_home_closes_with_a_mounted_hinge(folder, run_command):
    run_command(0, "new", "arm", "--urdf", "iiwa.urdf", "--name", "iiwa14")
    set_home("home_deg: [0, 0, 0, 0, 0, 0, 0]")
    point, direction = hinge_pin(MOUNTED_DEG)
    fixture = (
        "--kind hinge --arm iiwa14.yaml --name it --hand-point 60,0,80 --hand-direction 1,0.3,-0.2 "
        f"--base-point {','.join(f'{1e3 * v:.4f}' for v in point)} "
        f"--base-direction {','.join(f'{v:.6f}' for v in direction)}"
    )
    run_command(0, "new", "fixture", *fixture.split())
    report = run_command(0, "check", "iiwa14.yaml", "it.yaml").out
    (line,) = re.findall(r"^  (home_deg: \[.*\])$", report, re.MULTILINE)
    set_home(line)
    home_point, home_direction = hinge_pin(home_deg())
    # The proposal is rounded to whole degrees.
    assert np.linalg.norm(home_point - point) < 0.03
    assert abs(home_direction @ direction) > np.cos(np.deg2rad(3.0))
    assert least_motion(home_deg()) > 0.01
