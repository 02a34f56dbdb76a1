"""The message log: shown as far as there is room, and all of it on request."""

import pytest

from operator_app.session.ui.snapshot import Level
from operator_app.session.ui.steps import Step
from operator_app.tui.dialogs import Read
from tests.oracles.story import story

LONG = " ".join(f"word{k}" for k in range(90)) + ". Do what the last word says"


@pytest.mark.parametrize("size", [(80, 24), (120, 36)], ids=["80x24", "120x36"])
async def test_long_warning_names_the_key_that_shows_all(drive, size):
    async with drive(size=size) as d:
        d.runner.say(Level.INFO, "earlier message")
        d.runner.say(Level.WARNING, LONG)
        await d.until(lambda: "… (l shows all of it)" in d.words("#log"), "marked")
        assert "Do what the last word says" not in d.words("#log")
        await d.press("l")
        assert isinstance(d.app.screen, Read)
        log = " ".join((await d.dialog_text()).split())
        assert f"▲ {LONG}" in log
        assert log.index(LONG) < log.index("earlier message")
        assert max(map(len, (await d.dialog_text()).splitlines())) <= size[0] - 8


@pytest.mark.parametrize("size", [(80, 24), (120, 36)], ids=["80x24", "120x36"])
async def test_hint_and_log_share_their_rows(drive, size):
    async with drive(size=size) as d:
        await d.to_step(Step.FIXTURE)
        middle = d.app.main.query_one("#middle")

        async def rows(*, of: str) -> tuple[int, int, int]:
            d.app.main.refuse(of)
            d.app.poll()
            await d.settle()
            return d.app.main.hint.size.height, d.app.main.log_lines.size.height, middle.size.height

        hint_1, log_1, middle_1 = await rows(of="no")
        hint_2, log_2, middle_2 = await rows(of="no " * 30)
        assert (hint_1, hint_2) == (1, 2 if size[0] == 80 else 1)
        assert (hint_2 - hint_1, middle_2) == (log_1 - log_2, middle_1)


async def test_long_refusal_is_shown_in_full(still):
    async with still(story()["connected"], step=Step.FIXTURE, size=(80, 24)) as d:
        refusal = " ".join(f"word{k}" for k in range(38))
        d.app.main.refuse(refusal)
        d.app.poll()
        await d.settle()
        assert d.hint == f"▲ {refusal}"
