"""The one table of actions: a new entry is in the footer, the palette, help and the prompts, and works there."""

from textual.widgets import OptionList

from operator_app.commands.help_topic import manual
from operator_app.headless.plain import Plain
from operator_app.session.ui import action_table
from operator_app.session.ui.next_action import next_action
from operator_app.session.ui.snapshot import Level
from operator_app.session.ui.steps import Step
from operator_app.session.ui.user_interface import Action, OnScreen
from operator_app.tui.dialogs import Read
from operator_app.tui.palette import ActionProvider, title
from operator_app.tui.screen_interface import ON_SCREEN
from tests.oracles.story import busy, real, story

WHISTLE = Action(
    name="whistle",
    keys=("W",),
    shown="W",
    label="Whistle",
    help="Blow the whistle beside the arm.",
    steps=frozenset({Step.CONNECT}),
    footer=frozenset({Step.CONNECT}),
    guard=lambda s: ("there is nobody to hear it",) if s.connected else (),
    work=lambda chosen: chosen.runner.say(Level.INFO, "whistled"),
)


class Typist:
    """Types what it is given and keeps what it reads."""

    def __init__(self, *words: str) -> None:
        self.words, self.said = list(words), []

    def say(self, text: str) -> None:
        self.said += text.splitlines()

    def ask(self, prompt: str) -> str:
        if not self.words:
            raise EOFError
        word = self.words.pop(0)
        found = [row.split()[0] for row in self.said if f" {word}" in row]
        return found[-1] if found else word

    def touched(self, timeout_s: float) -> bool:
        return False


async def test_a_new_entry_is_everywhere_and_works_everywhere(still, source, monkeypatch) -> None:
    monkeypatch.setattr(action_table, "ACTIONS", (*action_table.ACTIONS, WHISTLE))

    async with still(story()["start"], step=Step.CONNECT) as d:
        assert "W Whistle" in d.text("#footer")
        await d.press("W")
        assert [m.text for m in d.s.messages[-1:]] == ["whistled"]
        palette = ActionProvider(d.app.main)
        assert title(WHISTLE) in [str(hit.text) async for hit in palette.discover()]
        await d.press("question_mark")
        assert "Whistle: Blow the whistle beside the arm." in " ".join((await d.reading()).split())
        await d.see(story()["connected"], Step.CONNECT)
        await d.press("W")
        assert "there is nobody to hear it" in d.hint

    typist = Typist("Whistle", "Connect", "Whistle")
    Plain(source, typist, pause=lambda _: None).run()
    assert any(row.endswith("Whistle: Blow the whistle beside the arm") for row in typist.said)
    assert sum("whistled" in row for row in typist.said) == 1
    assert "Not done: there is nobody to hear it." in typist.said


async def test_the_manual_is_read_on_the_screen_and_in_prompts(still, source) -> None:
    async with still(story()["captured"], step=Step.CAPTURE) as d:
        await d.press("m")
        await d.until(lambda: bool(d.app.screen.query(OptionList)), "the topics")
        assert d.app.screen.query_one("#box").border_title == "Manual"
        topics = [o.id for o in d.app.screen.query_one(OptionList).options[1:]]
        assert topics[0] == "tutorial"
        await d.press(*["down"] * (1 + topics.index("sign")), "enter")
        await d.until(lambda: isinstance(d.app.screen, Read), "the page")
        heading, line, *_ = (await d.reading()).splitlines()
        assert heading == manual().page("sign").title
        assert set(line) == {"="}
        assert max(map(len, (await d.reading()).splitlines())) <= 86
        await d.press("escape")
        assert d.app.screen is d.app.main

    typist = Typist("Read the manual", "keys:")
    Plain(source, typist, pause=lambda _: None).run()
    assert "Keys of the terminal app" in typist.said


def test_every_next_thing_is_an_action_of_its_step_or_of_all() -> None:
    for told in story().values():
        for s in (told, real(told)):
            for step in Step:
                name = next_action(step, s).action
                assert not name or step in action_table.by_name(name).steps


def test_every_action_of_the_screen_only_has_its_work_there() -> None:
    assert {a.name for a in action_table.ACTIONS if isinstance(a, OnScreen)} == set(ON_SCREEN)


def test_a_footer_that_is_full_gives_up_the_ways_out_first() -> None:
    here = frozenset({Step.FIXTURE})
    more = tuple(
        OnScreen(name=f"more {k}", keys=(), shown="", label="", help="", steps=here, footer=here)
        for k in range(2)
    )
    before = [a.name for a in action_table.footer(Step.FIXTURE)]
    assert before == ["stop", "primary", "procedure", "back", "help", "quit"]
    table = (*action_table.ACTIONS, *more)
    after = [a.name for a in action_table.footer(Step.FIXTURE, table)]
    assert after == ["stop", "primary", "procedure", "help", "more 0", "more 1"]


def test_guards_close_everything_that_works_while_work_is_in_hand() -> None:
    at_work = busy(story()["captured"], action_table.TaskKind.CALIBRATE, moves=False)
    free = {"stop_tested", "resume", "procedure", "confirm", "confirm_all", "suggest", "joints",
            "new_session", "acknowledge", "hold", "history", "manual"}  # fmt: skip
    for action in action_table.ACTIONS:
        if isinstance(action, Action):
            assert bool(action.guard(at_work)) == (action.name not in free), action.name
