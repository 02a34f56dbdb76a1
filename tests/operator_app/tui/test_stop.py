"""STOP by key and by mouse: at every step, under every dialog, and what is allowed after it."""

from textual import events

from operator_app.session.ui.snapshot import TaskKind
from operator_app.session.ui.steps import Step
from operator_app.tui.dialogs import Ask, Confirm, Read
from tests.oracles.story import busy, stopped, story


async def test_stop_works_at_every_step_and_is_not_a_cancel(still):
    moving = busy(story()["capturing"], TaskKind.MOVE, moves=True)
    async with still(story()["solved"]) as d:
        for step, picture in (
            *((step, story()["solved"]) for step in Step),
            (Step.CAPTURE, moving),
        ):
            for key in ("space", "f8"):
                await d.show(picture, step)
                await d.press(key)
                assert (d.runner.stops, d.runner.cancels, d.runner.asked) == (1, 0, []), (step, key)


async def test_stop_does_not_wait_for_the_event_loop(still):
    async with still(story()["solved"], step=Step.RESULTS) as d:
        d.app._driver.process_message(events.Key("f8", None))
        # Nothing was awaited: the event loop has not run yet.
        assert d.runner.stops == 1
        await d.settle()
        assert d.runner.stops == 1
        await d.press("n", "f8")
        assert d.runner.stops == 2


class HandledOnInput(list):
    """Keys handled on input; the thread that reads keys adds one while another is looked up."""

    def remove(self, event):
        super().remove(event)
        self.append(events.Key("f8", None))


async def test_a_key_that_is_read_meanwhile_does_not_send_stop_twice(still):
    async with still(story()["solved"]) as d:
        d.app._stops_handled = HandledOnInput()
        await d.press("f8")
        assert d.runner.stops == 1


DIALOGS = [
    (Step.MODES, "ticked", "a", Confirm),
    (Step.CAPTURE, "capturing", "n", Ask),
    (Step.EXPORT, "written", "u", Ask),
    (Step.EXPORT, "written", "N", Confirm),
    (Step.EXPORT, "solved", "y", Confirm),
    *((Step.CAPTURE, "capturing", key, Confirm) for key in ("q", "ctrl+c", "ctrl+q")),
    *((Step.CAPTURE, "capturing", key, Read) for key in ("question_mark", "f1")),
]


async def test_dialogs_open_close_and_accept_f8(still):
    async with still(story()["start"]) as d:
        for step, name, key, kind in DIALOGS:
            await d.show(story()[name], step)
            await d.press(key)
            assert isinstance(d.app.screen, kind), (step, key)
            if kind is Confirm:
                assert d.app.focused.id == "cancel"
            await d.press("f8")
            assert d.runner.stops == 1
            await d.press("escape")
            assert d.app.screen is d.app.main, (step, key)
            assert d.runner.asked == []
            assert d.app.step is step
            assert d.app.is_running


async def test_space_stops_except_in_a_note(still):
    async with still(story()["capturing"], step=Step.CAPTURE) as d:
        await d.press("q")
        await d.press("space")
        assert d.runner.stops == 1
        await d.press("escape")
        await d.press("n")
        await d.press("a", "space", "b")
        assert d.runner.stops == 1
        await d.press("f8")
        assert d.runner.stops == 2
        await d.press("enter")
        await d.settle()
        assert [k for k, _ in d.runner.asked] == [TaskKind.NOTE]


async def test_modified_keys_and_mouse_stop_under_a_dialog(still):
    def mouse_down(x: int, y: int) -> events.MouseDown:
        plain = {"shift": False, "meta": False, "ctrl": False}
        return events.MouseDown(None, x, y, 0, 0, button=1, screen_x=x, screen_y=y, **plain)

    async with still(story()["solved"], step=Step.EXPORT) as d:
        await d.press("y")
        d.app._driver.process_message(events.Key("shift+space", " "))
        d.app._driver.process_message(events.Key("ctrl+f8", None))
        assert d.runner.stops == 2
        for x, y in [(3, 0), (40, 0), (3, 1)]:
            d.app._driver.process_message(mouse_down(x, y))
        assert d.runner.stops == 3
        await d.settle()


async def test_stop_allows_only_the_reset(still):
    async with still(stopped(story()["capturing"]), step=Step.CAPTURE) as d:
        assert "SOFTWARE STOP" in d.text("#banner")
        assert "all 7 drives stopped within 12 ms" in d.text("#banner")
        await d.press("a")
        await d.until(lambda: "STOP is latched" in d.hint)
        assert d.runner.asked == []
        await d.press("R")
        assert [k for k, _ in d.runner.asked] == [TaskKind.RESET]
