"""The one table of actions, as footer, palette and help show it."""

from dataclasses import replace

import pytest

from operator_app.session.ui.action_table import ACTIONS, by_name, footer, for_key
from operator_app.session.ui.snapshot import TaskKind
from operator_app.session.ui.steps import Step
from operator_app.tui.dialogs import Read
from operator_app.tui.palette import ActionProvider, title
from operator_app.tui.screen_interface import help_text
from tests.oracles.story import story


def test_no_key_means_two_things_at_one_step():
    for step in Step:
        here = [a for a in ACTIONS if step in a.steps]
        keys = [k for a in here for k in a.keys]
        assert len(keys) == len(set(keys)), step


def test_the_footer_has_at_most_six_keys_that_all_work_there_and_stop_is_first():
    for step in Step:
        shown = footer(step)
        assert len(shown) <= 6
        assert shown[0].name == "stop"
        assert "help" in [a.name for a in shown]
        for action in shown:
            assert for_key(action.keys[0], step) is action


@pytest.mark.campaign
async def test_every_action_is_in_the_palette_and_in_help(still):
    async with still(story()["start"]) as d:
        provider = ActionProvider(d.app.main)
        found = [str(hit.text) async for hit in provider.discover()]
        for action in ACTIONS:
            assert title(action) in found
            searched = [str(hit.text) async for hit in provider.search(action.label)]
            assert title(action) in searched
            page = help_text(min(action.steps), None, 400)
            assert f"{action.label}: {action.help}" in page


async def test_help_explains_the_focused_panel(still):
    async with still(story()["capturing"], step=Step.CAPTURE) as d:
        await d.press("tab", "question_mark")
        assert isinstance(d.app.screen, Read)
        panel = d.app.main.focused
        assert panel.HELP[:40] in " ".join((await d.reading()).split())


async def test_an_action_from_the_palette_goes_to_its_step_if_that_is_open(still):
    async with still(story()["captured"], step=Step.CONNECT) as d:
        d.app.interface.do_anywhere(by_name("calibrate"))
        assert d.app.step is Step.CALIBRATE
        assert [k for k, _ in d.runner.asked] == [TaskKind.CALIBRATE]
        d.app.interface.do_anywhere(by_name("write"))
        assert d.app.step is Step.CALIBRATE
        assert len(d.runner.asked) == 1


async def test_a_calibration_of_other_poses_is_said_to_be_one_and_nothing_of_it_is_shown(still):
    solved = story()["solved"]
    poses = tuple(replace(p, excluded="bumped") for p in solved.state.poses)
    none_counts = replace(solved, state=replace(solved.state, poses=poses))
    async with still(story()["solved"], step=Step.RESULTS) as d:
        for step in (Step.RESULTS, Step.CALIBRATE, Step.EXPORT):
            await d.see(none_counts, step)
            for _ in range(3):
                await d.press("v")
        await d.see(none_counts, Step.RESULTS)
        assert "the poses have changed since the calibration" in d.words("#verdict")
