"""What each step looks like, at both sizes, dark and without colour. Look before you update them."""

import pytest

from operator_app.session.ui.snapshot import TaskKind
from operator_app.session.ui.steps import Step
from operator_app.tui.app import SarcalApp
from operator_app.tui.theme import DARK, LIGHT, NO_COLOUR
from tests.oracles.still_runner import StillSource
from tests.oracles.story import busy, diverged, lost, stale, stopped, story

SIZES = [(120, 36), (80, 24)]
SCREENS = {
    Step.CONNECT: "connected",
    Step.FIXTURE: "connected",
    Step.MODES: "ticked",
    Step.CAPTURE: "capturing",
    Step.CALIBRATE: "captured",
    Step.RESULTS: "solved",
    Step.EXPORT: "written",
}


@pytest.fixture
def compare(snap_compare, monkeypatch):
    """Compare one picture at one step with what is kept."""
    monkeypatch.delenv("NO_COLOR", raising=False)

    def look(picture, step, size, *, press=(), **options):
        # Textual waits for an idle processor, which repaints never leave; the one picture is shown here.
        app = SarcalApp(lambda: StillSource(picture), poll_s=3600.0, **options)

        async def show(pilot) -> None:
            while app.runner is None:
                await pilot.pause(0.001)
            app.step = step
            app.main.go_to(step)
            await pilot.pause()
            app.poll()
            await pilot.pause()

        return snap_compare(app, terminal_size=size, run_before=show, press=press)

    return look


@pytest.mark.sample(13)
@pytest.mark.parametrize("theme", [DARK, NO_COLOUR])
@pytest.mark.parametrize("size", SIZES, ids=["120x36", "80x24"])
@pytest.mark.parametrize("step", list(Step), ids=lambda step: step.title)
def test_step(compare, step, size, theme):
    assert compare(story()[SCREENS[step]], step, size, theme=theme)


def test_light(compare):
    assert compare(story()["capturing"], Step.CAPTURE, SIZES[0], theme=LIGHT)


def test_ascii(compare):
    assert compare(story()["capturing"], Step.CAPTURE, SIZES[0], ascii_only=True)


@pytest.mark.sample(5)
@pytest.mark.parametrize("size", SIZES, ids=["120x36", "80x24"])
@pytest.mark.parametrize("what", ["stopped", "diverged", "stale", "lost", "moving"])
def test_fault_states(compare, what, size):
    told = story()["capturing"]
    picture = {
        "stopped": stopped(told),
        "diverged": diverged(told),
        "stale": stale(told),
        "lost": lost(told),
        "moving": busy(told, TaskKind.AUTOMATIC, moves=True),
    }[what]
    assert compare(picture, Step.CAPTURE, size)


@pytest.mark.parametrize("size", SIZES, ids=["120x36", "80x24"])
def test_dialog_leaves_strip_and_rail_visible(compare, size):
    assert compare(story()["ticked"], Step.MODES, size, press=("a",))


def test_second_results_page(compare):
    assert compare(story()["solved"], Step.RESULTS, SIZES[0], press=("v",))


def test_too_small(compare):
    assert compare(story()["capturing"], Step.CAPTURE, (70, 20))
