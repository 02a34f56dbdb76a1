"""The action table: each action is in footer, palette, help and prompts, and works there."""

import re
from dataclasses import replace
from types import SimpleNamespace

import pytest
from textual.widgets import OptionList

from operator_app.commands.help_topic import manual
from operator_app.headless.plain import Plain
from operator_app.session.ui import action_table
from operator_app.session.ui.action_handlers import go
from operator_app.session.ui.action_table import ACTIONS, by_name, footer, for_key
from operator_app.session.ui.next_action import next_action
from operator_app.session.ui.snapshot import Level, TaskKind
from operator_app.session.ui.steps import Step
from operator_app.session.ui.user_interface import Action, OnScreen
from operator_app.tui.app import ActionProvider
from operator_app.tui.dialogs import Read
from operator_app.tui.lines import Lines
from operator_app.tui.screen_interface import ON_SCREEN
from tests.oracles.script import Script, pause_briefly
from tests.oracles.story import busy, real, story

WHISTLE = Action(
    name="whistle",
    keys=("W",),
    shown="W",
    label="Whistle",
    help="Blow the whistle beside the arm.",
    steps=frozenset({Step.CONNECT}),
    footer=frozenset({Step.CONNECT}),
    guard=lambda s: "an arm is connected" if s.connected else "",
    work=lambda chosen: chosen.runner.say(Level.INFO, "whistled"),
)


async def test_new_action_appears_and_works_in_all_interfaces(still, source, monkeypatch):
    monkeypatch.setattr(action_table, "ACTIONS", (*ACTIONS, WHISTLE))

    async with still(story()["start"], step=Step.CONNECT) as d:
        assert "W Whistle" in d.text("#footer")
        await d.press("W")
        assert [m.text for m in d.s.messages[-1:]] == ["whistled"]
        palette = ActionProvider(d.app.main)
        title = "Whistle (step 1)  [W]"
        assert title in [str(hit.text) async for hit in palette.discover()]
        assert title in [str(hit.text) async for hit in palette.search("Whistle")]
        await d.press("question_mark")
        assert "Whistle: Blow the whistle beside the arm." in " ".join(
            (await d.dialog_text()).split()
        )
        await d.show(story()["connected"], Step.CONNECT)
        await d.press("W")
        assert "an arm is connected" in d.hint

    script = Script("Whistle", "Connect", "Whistle")
    Plain(source, script, pause=pause_briefly).run()
    assert any(row.endswith("Whistle: Blow the whistle beside the arm") for row in script.lines)
    assert sum("whistled" in row for row in script.lines) == 1
    assert "Not done: an arm is connected." in script.lines


async def test_manual_is_shown_on_screen_and_in_prompts(still, source):
    async with still(story()["captured"], step=Step.CAPTURE) as d:
        await d.press("m")
        await d.until(lambda: bool(d.app.screen.query(OptionList)), "the topics")
        assert d.app.screen.query_one("#box").border_title == "Manual"
        topics = [o.id for o in d.app.screen.query_one(OptionList).options[1:]]
        assert topics[0] == "tutorial"
        await d.press(*["down"] * (1 + topics.index("sign")), "enter")
        await d.until(lambda: isinstance(d.app.screen, Read), "the page")
        heading, line, *_ = (await d.dialog_text()).splitlines()
        assert heading == manual().page("sign").partition("\n")[0].removeprefix("# ")
        assert set(line) == {"="}
        assert max(map(len, (await d.dialog_text()).splitlines())) <= 86
        await d.press("escape")
        assert d.app.screen is d.app.main

    script = Script("Read the manual", "keys:")
    Plain(source, script, pause=pause_briefly).run()
    assert "Keys of the terminal app" in script.lines


def test_next_action_belongs_to_its_step():
    for snapshot in story().values():
        for s in (snapshot, real(snapshot)):
            for step in Step:
                name = next_action(step, s).action
                assert not name or step in by_name(name).steps


def test_full_footer_drops_back_and_quit_first():
    for step, expected in (
        (Step.FIXTURE, ["stop", "primary", "procedure", "back", "help", "quit"]),
        (Step.CALIBRATE, ["stop", "primary", "estimator", "unsensed", "back", "help"]),
        (Step.MODES, ["stop", "primary", "toggle_mode", "suggest", "wiggle", "help"]),
    ):
        assert [a.name for a in footer(step)] == expected


def test_guards_block_actions_while_a_task_runs():
    allowed = {"stop_tested", "resume", "procedure", "confirm", "confirm_all", "suggest", "joints",
            "new_session", "acknowledge", "hold", "history", "manual"}  # fmt: skip
    blocked = set()
    for name in ("start", "capturing", "captured", "solved"):
        task_running = busy(story()[name], TaskKind.EXPORT, moves=False)
        for action in ACTIONS:
            if isinstance(action, Action) and action.name not in allowed:
                missing = action.guard(task_running)
                assert missing, action.name
                if not action.guard(story()[name]):
                    assert missing == "wait: writing", action.name
                    blocked.add(action.name)
    assert {"connect", "capture", "go", "automatic", "undo", "calibrate"} <= blocked
    assert {"write", "upload", "report", "verify"} <= blocked


def test_keys_are_unique_and_the_footer_starts_with_stop():
    assert {a.name for a in ACTIONS if isinstance(a, OnScreen)} == set(ON_SCREEN)
    for step in Step:
        keys = [key for action in ACTIONS if step in action.steps for key in action.keys]
        assert len(keys) == len(set(keys)), step
        shown = footer(step)
        assert len(shown) <= 6
        assert shown[0].name == "stop"
        assert "help" in [a.name for a in shown]
        for action in shown:
            assert for_key(action.keys[0], step) is action


async def test_help_describes_the_focused_panel(still):
    headings = re.findall(r"^### (.+)", manual().page("panels"), re.MULTILINE)
    async with still(story()["capturing"], step=Step.CAPTURE) as d:
        await d.press("tab", "question_mark")
        assert isinstance(d.app.screen, Read)
        assert "This panel (Joints): One row per joint." in await d.dialog_text()
        panels = [p for view in d.app.main.steps for p in view.query(Lines) if p.can_focus]
        assert {panel.TITLE for panel in panels} == set(headings)


async def test_palette_action_goes_to_its_open_step(still):
    async with still(story()["captured"], step=Step.CONNECT) as d:
        d.app.interface.do_anywhere(by_name("calibrate"))
        assert d.app.step is Step.CALIBRATE
        assert [k for k, _ in d.runner.asked] == [TaskKind.CALIBRATE]
        d.app.interface.do_anywhere(by_name("write"))
        assert d.app.step is Step.CALIBRATE
        assert len(d.runner.asked) == 1


async def test_outdated_calibration_is_not_shown(still):
    solved = story()["solved"]
    poses = tuple(replace(p, excluded="bumped") for p in solved.state.poses)
    all_excluded = replace(solved, state=replace(solved.state, poses=poses))
    async with still(story()["solved"], step=Step.RESULTS) as d:
        for step in (Step.RESULTS, Step.CALIBRATE, Step.EXPORT):
            await d.show(all_excluded, step)
            for _ in range(3):
                await d.press("v")
        await d.show(all_excluded, Step.RESULTS)
        assert "the poses have changed since the calibration" in d.words("#verdict")


@pytest.mark.parametrize("waypoint", [None, 0, 4])
def test_without_a_waypoint_nothing_moves(waypoint):
    refused, gone = list[str](), list[int]()
    context = SimpleNamespace(
        interface=SimpleNamespace(refuse=refused.append),
        submit=lambda _, work, __: work(SimpleNamespace(go=gone.append)),
    )
    go(context, waypoint)
    assert gone == ([] if waypoint is None else [waypoint])
    assert len(refused) == (waypoint is None)
