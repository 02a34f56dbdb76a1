"""The whole way by keys: how many it takes, what is written, resuming."""

import re

import pytest

from operator_app.config.parameters_file import load_parameters
from operator_app.manual.pages import Manual, reference
from operator_app.session.ui.next_action import next_action
from operator_app.session.ui.steps import Step
from operator_app.tui.dialogs import Ask, Confirm, Read

MOST_KEYS = 25


def asked_for(d):
    """Step and what comes next there."""
    return d.app.step, next_action(d.app.step, d.s).action


async def test_the_keys_of_the_tutorial_end_with_uploaded_parameters_and_the_app_closed(
    drive, source
):
    page = Manual(reference()).page("tutorial").markdown
    sections = re.findall(r"^### (\d)[^\n]*\n\nKeys: ([^\n]+)$", page, flags=re.MULTILINE)
    assert [int(number) for number, _ in sections] == [1, 2, 3, 4, 5, 7]
    async with drive() as d:
        for number, keys in sections:
            assert d.app.step == int(number)
            for bold, typed in re.findall(r"\*\*(Enter)\*\*|`([^`]+)`", keys):
                if d.app.screen is d.app.main:
                    before = asked_for(d)
                if typed == "q":
                    assert source.arm.active_parameters() == d.s.written.parameters.read_bytes()
                await d.press(*(["enter"] if bold else typed))
                await d.until(
                    lambda was=before: (
                        d.app._exit or d.app.screen is not d.app.main or asked_for(d) != was
                    ),
                    f"step {number}: {keys}",
                )
                if not d.app._exit and d.app.screen is d.app.main:
                    await d.idle()
        assert d.app._exit


@pytest.mark.campaign
async def test_following_the_footer_alone_ends_with_uploaded_parameters(drive, source):
    async with drive((80, 24)) as d:
        for _ in range(MOST_KEYS):
            if d.s.receipt is not None:
                break
            if d.app.screen is not d.app.main:
                if isinstance(d.app.screen, Ask):
                    await d.press(*"SDA-0001")
                    await d.press("enter")
                else:
                    await d.press("y")
            else:
                assert "Enter" in d.text("#footer"), d.hint
                await d.press("enter")
            if d.app.screen is d.app.main:
                await d.idle()
        assert d.pressed <= MOST_KEYS
        assert d.s.receipt is not None
        written = load_parameters(d.s.written.parameters)
        assert written.arm.serial == "SDA-0001"
        assert source.arm.active_parameters() == d.s.written.parameters.read_bytes()


@pytest.mark.campaign
async def test_a_session_left_in_the_middle_is_offered_and_goes_on(drive, source):
    source.pace_s = 0.01
    async with drive() as d:
        await d.to_step(Step.CAPTURE)
        await d.press("a")
        await d.until(lambda: len(d.s.state.poses) >= 2, "two poses")
        await d.press("x")
        await d.idle()
        taken = len(d.s.state.poses)
        assert 2 <= taken < d.s.wanted_poses
    source.close("left")
    source.pace_s = 0.0
    async with drive() as d:
        await d.until(lambda: isinstance(d.app.screen, Confirm), "offered")
        await d.press("y")
        await d.until(lambda: len(d.s.state.poses) == taken, "poses back")
        assert d.app.step is Step.CONNECT
        # Arm, fixture and modes are asked for again.
        await d.press("4")
        await d.until(lambda: "Capture is closed: no arm is connected" in d.hint, "refusal")
        await d.to_step(Step.CAPTURE)
        await d.press("a")
        await d.idle()
        assert len(d.s.state.used_poses) == d.s.wanted_poses
        assert [p.number for p in d.s.state.poses] == list(range(1, d.s.wanted_poses + 1))


@pytest.mark.campaign
async def test_a_resumed_session_insists_on_its_arm(drive, source):
    async with drive() as d:
        await d.to_step(Step.CAPTURE)
        await d.press("g")
        await d.idle()
        await d.press("c")
        await d.idle()
        assert len(d.s.state.poses) == 1
    source.close("left")
    source.serial = "SDA-0002"
    async with drive() as d:
        await d.until(lambda: d.app.screen is not d.app.main, "offered")
        await d.press("y")
        await d.until(lambda: bool(d.s.state.poses), "resumed")
        await d.press("enter")
        await d.idle()
        assert not d.s.connected
        assert not source.arm.connected
        assert "belongs to arm SDA-0001" in d.s.messages[-1].text


@pytest.mark.campaign
async def test_after_a_stop_it_is_uploaded_with_drives_off_and_verified_by_one_key(drive, source):
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
        assert "1 accepted calibration, 1 verification" in (await d.reading())
