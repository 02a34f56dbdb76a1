"""The terminal app on arms of another package: one with drives, and one that a person moves."""

import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from hardware.timing import Pace
from operator_app.composition import open_arm
from operator_app.session.ui import guards
from operator_app.session.ui.next_action import next_action
from operator_app.session.ui.sessions import Sessions
from operator_app.session.ui.steps import Step
from operator_app.session.workflow.opening import Choices
from operator_app.tui.app import SarcalApp
from tests.operator_app.tui.conftest import Driver, running
from tests.oracles.story import story
from tests.oracles.toy_arm import PROCEDURE, Toy, package, toy


@asynccontextmanager
async def app_on(name: str, arm: Toy, folder: Path) -> AsyncIterator[Driver]:
    procedure = folder / "quick.yaml"
    procedure.write_text(PROCEDURE)
    source = Sessions(
        str(procedure),
        Choices(interface=name, channel=arm.channel),
        root=folder / "sessions",
        join=lambda opening: open_arm(opening, pace=Pace.REAL_TIME),
    )
    app = SarcalApp(lambda: source)
    try:
        async with running(app) as driver:
            yield driver
    finally:
        source.close("end of the test")


@pytest.fixture
def installed(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(package(tmp_path / "package"))
    return tmp_path / "package"


@pytest.mark.campaign
async def test_external_moving_arm_is_calibrated_by_keys(installed, tmp_path):
    with toy(installed) as arm:
        async with app_on("moving_line_arm", arm, tmp_path) as d:
            await d.to_step(Step.CAPTURE)
            assert d.s.identity.serial_number == "TOY-0001"
            assert d.s.simulated, "its nodes report that nothing real moves"
            await d.press("a")
            await d.idle()
            assert len(d.s.state.used_poses) == 6
            await d.to_step(Step.RESULTS)
            assert d.s.solution.accepted, d.s.solution.reasons
            await d.to_step(Step.EXPORT)
            await d.press("enter")
            await d.idle()
            assert (d.s.folder / "parameters.yaml").is_file()


async def test_external_hand_guided_arm_shows_targets(installed, tmp_path):
    with toy(installed, "--by-hand") as arm:
        async with app_on("line_arm", arm, tmp_path) as d:
            await d.to_step(Step.CAPTURE)
            await d.press("g")
            await d.until(lambda: "By hand: take J1" in d.s.messages[-1].text, "prompt")
            targets = re.findall(r"J(\d) to ([-+][\d.]+) deg", d.s.messages[-1].text)
            assert [j for j, _ in targets] == ["1", "5"]
            arm.type(" ".join(f"{j} {float(q)}" for j, q in targets))
            await d.idle()
            assert d.s.at_waypoint == 0
            await d.press("c")
            await d.idle()
            (pose,) = d.s.state.poses
            assert [pose.mean_rad[0], pose.mean_rad[4]] == pytest.approx(
                [float(q) * 0.017453 for _, q in targets], abs=0.04
            )
            # A key ends the waiting for the person.
            await d.press("g")
            await d.until(lambda: d.s.task is not None and d.s.task.moves, "waiting")
            await d.press("x")
            await d.idle()
            assert not d.s.stopped


def test_arm_without_parameter_store_is_not_offered_an_upload():
    s = story()["written"]
    s = replace(s, identity=replace(s.identity, keeps_parameters=False))
    assert next_action(Step.EXPORT, s).action == "quit"
    reason = "this arm stores no parameters: use the files in the session folder"
    assert guards.may_upload(s) == reason
