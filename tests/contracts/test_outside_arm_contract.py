"""The contract for arms of outside packages, run on the embedded arm and the manual's two."""

import os
import subprocess
import sys

import pytest
from sarcal import arm_contract
from sarcal.arm_contract import *  # noqa: F403 - the tests
from sarcal.arm_contract import fulfils

from hardware.commissioning.bench_check import Bench, Stage, check
from hardware.commissioning.clauses import Clause
from hardware.control.canopen_arm import CanopenArm
from operator_app.composition import describe
from tests.oracles.toy_arm import package, toy


@pytest.fixture(scope="module", params=["virtual", "moving_line_arm", "line_arm"])
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
    """Without the stages that move it: in a fixture no joint can turn alone."""
    bench.arm.close()
    arm_check = Bench(
        arm=bench.arm,
        description=describe(bench.procedure.arm),
        ask=lambda _: True,
        step_rad=arm_contract.STEP_RAD,
        speed_rad_per_s=bench.speed_rad_per_s,
        interrupt=lambda: None,
        bounds=arm_contract.BOUNDS,
    )
    findings = list(check(arm_check, last=Stage.HOLD))
    assert {f.name: f.text for f in findings if f.passed is False} == {}
    assert {f.stage for f in findings} == {Stage.LOOK, Stage.HOLD}
    if isinstance(bench.arm, CanopenArm):
        # The embedded arm's heartbeat time-out of 10 s is accepted in runs, and reported by the check.
        assert {f.passed for f in findings if f.name == "guard"} == {None}


def test_fulfils_skips_unknown_and_fails_empty_clauses():
    def clause(name: str, *, passed: bool | None) -> Clause:
        return Clause(name=name, passed=passed, text="observation")

    passed, unknown = clause("passed", passed=True), clause("torque", passed=None)
    fulfils(iter([passed]))
    with pytest.raises(pytest.skip.Exception, match="torque: observation"):
        fulfils([unknown, passed])
    with pytest.raises(AssertionError, match="nothing was tried"):
        fulfils(())
    clauses = iter([unknown, clause("wrong", passed=False), passed])
    with pytest.raises(AssertionError, match="wrong: observation"):
        fulfils(clauses)
    assert list(clauses) == [passed], "nothing is tried after a failure, as the arm may be moving"


@pytest.mark.campaign
def test_installed_outside_package_passes_contract(tmp_path):
    """As in the manual, in a folder without the project's sources."""
    folder, target = tmp_path / "package", tmp_path / "target"
    package(folder)
    install = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation"]
    subprocess.run([*install, "--no-index", "--target", target, folder], check=True)
    with toy(folder, "--rate", "100") as arm:
        bus = {"CAN_INTERFACE": "moving_line_arm", "CAN_CHANNEL": arm.channel}
        run = subprocess.run(
            [sys.executable, "-m", "pytest", "--pyargs", "sarcal.arm_contract"],
            env=os.environ | bus | {"PYTHONPATH": str(target)},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
    assert "14 passed" in run.stdout, run.stdout
