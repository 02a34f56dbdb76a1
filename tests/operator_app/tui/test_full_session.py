"""A whole calibration by keys: how many it takes, and what is written."""

import re

import pytest

from operator_app.manual.pages import Manual
from operator_app.session.ui.next_action import next_action
from operator_app.session.ui.steps import Step
from operator_app.tui.dialogs import Read

MOST_KEYS = 25


def next_step(d):
    """Current step and its next action."""
    return d.app.step, next_action(d.app.step, d.s).action


async def test_tutorial_keys_upload_parameters_and_quit(drive, source):
    page = Manual().page("tutorial").markdown
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
    async with drive() as d:
        await d.to_step(Step.EXPORT)
        await d.press("f8")
        await d.until(lambda: d.s.stopped, "stopped")
        await d.press("R")
        await d.idle()
        await d.press("u")
        await d.press(*"SDA-0001")
        await d.press("enter")
        await d.idle()
        assert d.s.receipt is not None, d.s.messages[-1].text
        assert not d.s.drives_ready
        await d.press("y")
        await d.press("y")
        await d.idle()
        assert d.s.verification is not None, d.s.messages[-1].text
        await d.press("i")
        await d.until(lambda: isinstance(d.app.screen, Read), "history")
        assert "1 accepted calibration, 1 verification" in (await d.dialog_text())
