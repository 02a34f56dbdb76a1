"""The contract that outside packages run, run on the arms we have: the embedded one, and the manual's two."""

import os
import subprocess
import sys

import pytest
from sarcal import arm_contract
from sarcal.arm_contract import *  # noqa: F403 - the tests
from sarcal.arm_contract import fulfils

from hardware.commissioning.bench_check import Bench as Tried
from hardware.commissioning.bench_check import check
from hardware.commissioning.stages import Clause, Stage
from hardware.control.canopen_arm import CanopenArm
from operator_app.composition import describe
from tests.oracles.toy_arm import package, toy

ARMS = ("virtual", "moving_line_arm", "line_arm")


@pytest.fixture(scope="module", params=ARMS)
def bench(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("toy")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(package(folder / "package"))
        patch.setenv("CAN_INTERFACE", request.param)
        with toy(folder / "package", "--rate", "100") as arm:
            if request.param != "virtual":
                patch.setenv("CAN_CHANNEL", arm.channel)
            yield from arm_contract.bench.__wrapped__(tmp_path_factory)


def test_arm_check_passes_contract_arms(bench):
    """All but what moves it: in a fixture one joint is not turned alone."""
    bench.arm.close()
    made = Tried(
        arm=bench.arm,
        description=describe(bench.procedure.arm),
        ask=lambda _: True,
        step_rad=arm_contract.STEP_RAD,
        speed_rad_per_s=bench.speed_rad_per_s,
        bounds=arm_contract.BOUNDS,
    )
    found = list(check(made, last=Stage.HOLD))
    assert {f.name: f.text for f in found if f.passed is False} == {}
    assert {f.stage for f in found} == {Stage.LOOK, Stage.HOLD}
    if isinstance(bench.arm, CanopenArm):
        # The embedded arm waits 10 s for its operator: runs put up with that, a bench is told.
        assert {f.passed for f in found if f.name == "guard"} == {None}


def test_fulfils_skips_unknown_and_fails_empty_clauses():
    def clause(name: str, *, passed: bool | None) -> Clause:
        return Clause(name=name, passed=passed, text="as it was seen")

    fine, unknown = clause("fine", passed=True), clause("torque", passed=None)
    fulfils(iter([fine]))
    with pytest.raises(pytest.skip.Exception, match="torque: as it was seen"):
        fulfils([unknown, fine])
    with pytest.raises(AssertionError, match="nothing was tried"):
        fulfils(())
    left = iter([unknown, clause("wrong", passed=False), fine])
    with pytest.raises(AssertionError, match="wrong: as it was seen"):
        fulfils(left)
    # What comes after a failure is not tried any more: the arm may be moving.
    assert list(left) == [fine]


@pytest.mark.campaign
def test_installed_outside_package_passes_contract(tmp_path):
    """As the manual says, in a folder that has nothing of ours."""
    folder, target = tmp_path / "package", tmp_path / "target"
    package(folder)
    install = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation"]
    subprocess.run([*install, "--no-index", "--target", target, folder], check=True)
    with toy(folder, "--rate", "100") as arm:
        bus = {"CAN_INTERFACE": "moving_line_arm", "CAN_CHANNEL": arm.channel}
        found = subprocess.run(
            [sys.executable, "-m", "pytest", "--pyargs", "sarcal.arm_contract"],
            env=os.environ | bus | {"PYTHONPATH": str(target)},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
    assert "14 passed" in found.stdout, found.stdout
