"""The contract that outside packages run, run on the arms we have: the embedded one, and the manual's two."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from sarcal import arm_contract
from sarcal.arm_contract import *  # noqa: F403 - the tests
from sarcal.arm_contract import Bench

from oracles.toy_arm import package, toy

ARMS = ("virtual", "moving_line_arm", "line_arm")


@pytest.fixture(scope="module", params=ARMS)
def bench(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Bench]:
    folder = tmp_path_factory.mktemp("toy")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(package(folder / "package"))
        patch.setenv("CAN_INTERFACE", request.param)
        with toy(folder / "package") as arm:
            if request.param != "virtual":
                patch.setenv("CAN_CHANNEL", arm.channel)
            yield from arm_contract.bench.__wrapped__(tmp_path_factory)


@pytest.mark.campaign
def test_an_outside_package_installs_and_runs_it_by_itself(tmp_path: Path) -> None:
    """As the manual says, in a folder that has nothing of ours."""
    folder, target = tmp_path / "package", tmp_path / "target"
    package(folder)
    install = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation"]
    subprocess.run([*install, "--no-index", "--target", target, folder], check=True)
    with toy(folder) as arm:
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
