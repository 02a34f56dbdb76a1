"""A whole calibration by keys: how many it takes, and what is written; also on an arm of another package."""

import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from hardware.timing import Pace
from operator_app.composition import open_arm
from operator_app.manual.pages import Manual
from operator_app.session.ui import guards
from operator_app.session.ui.next_action import next_action
from operator_app.session.ui.sessions import Sessions
from operator_app.session.ui.steps import Step
from operator_app.session.workflow.opening import Choices
from operator_app.tui.app import SarcalApp
from operator_app.tui.dialogs import Read
from tests.operator_app.tui.conftest import Driver, running
from tests.oracles.story import story
from tests.oracles.toy_arm import PROCEDURE, Toy, package, toy

MOST_KEYS = 25


def next_step(d):
    return d.app.step, next_action(d.app.step, d.s).action


async def test_tutorial_keys_upload_parameters_and_quit(drive, source):
    page = Manual().page("tutorial")
    sections = re.findall(r"^### (\d)[^\n]*\n\nKeys: ([^\n]+)$", page, flags=re.MULTILINE)
    assert [int(number) for number, _ in sections] == [1, 2, 3, 4, 5, 7]
    async with drive() as d:
        for number, keys in sections:
            assert "Enter" in d.text("#footer"), d.hint
            assert d.app.step == int(number)
            for bold, typed in re.findall(r"\*\*(Enter)\*\*|`([^`]+)`", keys):
                if d.app.screen is d.app.main:
                    before = next_step(d)
                if typed == "q":
                    assert source.arm.active_parameters() == d.s.written.parameters.read_bytes()
                await d.press(*(["enter"] if bold else typed))
                await d.until(
                    lambda was=before: (
                        d.app._exit or d.app.screen is not d.app.main or next_step(d) != was
                    ),
                    f"step {number}: {keys}",
                )
                if not d.app._exit and d.app.screen is d.app.main:
                    await d.idle()
        assert d.app._exit
        assert d.pressed <= MOST_KEYS


@pytest.mark.campaign
async def test_upload_and_verification_after_a_stop(drive, source):
    async with drive(step=Step.EXPORT) as d:
        await d.press("f8")
        await d.until(lambda: d.s.stopped, "stopped")
        await d.run("R")
        await d.press("u")
        await d.run(*"SDA-0001", "enter")
        assert d.s.receipt is not None, d.s.messages[-1].text
        assert not d.s.drives_ready
        await d.run("y", "y")
        assert d.s.verification is not None, d.s.messages[-1].text
        assert re.findall(r"[\d.]+ mm", d.words("#record"))[0] in d.s.messages[-1].text
        await d.press("i")
        await d.until(lambda: isinstance(d.app.screen, Read), "history")
        assert "1 accepted calibration, 1 verification" in (await d.dialog_text())


@asynccontextmanager
async def app_on(arm: Toy, folder: Path) -> AsyncIterator[Driver]:
    procedure = folder / "quick.yaml"
    procedure.write_text(PROCEDURE)
    source = Sessions(
        str(procedure),
        Choices(interface="line_arm", channel=arm.channel),
        root=folder / "sessions",
        join=lambda opening: open_arm(opening, pace=Pace.REAL_TIME),
    )
    try:
        async with running(SarcalApp(lambda: source)) as driver:
            yield driver
    finally:
        source.close("end of the test")


async def test_external_hand_guided_arm_shows_targets(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(package(tmp_path / "package"))
    with toy(tmp_path / "package", "--by-hand") as arm:
        async with app_on(arm, tmp_path) as d:
            await d.to_step(Step.CAPTURE)
            assert d.s.identity.serial_number == "TOY-0001"
            assert d.s.simulated, "its nodes report that nothing real moves"
            await d.press("g")
            await d.until(lambda: "By hand: move J1" in d.s.messages[-1].text, "prompt")
            targets = re.findall(r"J(\d) to ([-+][\d.]+) deg", d.s.messages[-1].text)
            assert [j for j, _ in targets] == ["1", "5"]
            arm.type(" ".join(f"{j} {float(q)}" for j, q in targets))
            await d.idle()
            assert d.s.at_waypoint == 0
            await d.run("c")
            (pose,) = d.s.state.poses
            assert [pose.mean_rad[0], pose.mean_rad[4]] == pytest.approx(
                [float(q) * 0.017453 for _, q in targets], abs=0.04
            )
            # A key ends the waiting for the person.
            await d.press("g")
            await d.until(lambda: d.s.task is not None and d.s.task.moves, "waiting")
            await d.run("x")
            assert not d.s.stopped


def test_arm_without_parameter_store_is_not_offered_an_upload():
    s = story()["written"]
    s = replace(s, identity=replace(s.identity, keeps_parameters=False))
    assert next_action(Step.EXPORT, s).action == "quit"
    reason = "this arm stores no parameters: use the files in the session folder"
    assert guards.may_upload(s) == reason
