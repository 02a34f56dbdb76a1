"""Screens of each step in both sizes, dark and without colour. Look before you update them."""

import pytest
from rich.color import Color, ColorSystem

from operator_app.session.ui.snapshot import TaskKind
from operator_app.session.ui.steps import Step
from operator_app.tui.app import SarcalApp
from operator_app.tui.theme import DARK, LIGHT, NO_COLOUR, look, themes
from tests.oracles.contrast import contrast
from tests.oracles.still_runner import StaticSource
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
    """Compare the screen of a snapshot at a step with the stored one."""
    monkeypatch.delenv("NO_COLOR", raising=False)

    def compare_screen(picture, step, size, *, press=(), **options):
        # Textual waits for an idle processor, which repaints never leave: poll once here.
        app = SarcalApp(lambda: StaticSource(picture), poll_s=3600.0, **options)

        async def show(pilot) -> None:
            while app.runner is None:
                await pilot.pause(0.001)
            app.main.go_to(step)
            await pilot.pause()
            app.poll()
            await pilot.pause()

        return snap_compare(app, terminal_size=size, run_before=show, press=press)

    return compare_screen


@pytest.mark.parametrize("system", [ColorSystem.TRUECOLOR, ColorSystem.EIGHT_BIT])
@pytest.mark.parametrize("theme", themes()[:2], ids=[DARK, LIGHT])
def test_text_has_contrast(theme, system):
    for role in ("text", "dim", "accent", "warn", "alarm"):
        ink = look(theme.name, ascii_only=False).styles[role].color
        for ground in map(Color.parse, (theme.background, theme.panel)):
            pair = [c.downgrade(system).get_truecolor().normalized for c in (ink, ground)]
            assert contrast(*pair) >= 4.5, (role, ground)


@pytest.mark.sample(13)
@pytest.mark.parametrize("theme", [DARK, NO_COLOUR])
@pytest.mark.parametrize("size", SIZES, ids=["120x36", "80x24"])
@pytest.mark.parametrize("step", list(Step), ids=lambda step: step.title)
def test_step(compare, step, size, theme):
    assert compare(story()[SCREENS[step]], step, size, theme=theme)


@pytest.mark.parametrize(
    ("name", "step", "size", "options"),
    [
        pytest.param("capturing", Step.CAPTURE, SIZES[0], {"theme": LIGHT}, id="light"),
        pytest.param("capturing", Step.CAPTURE, SIZES[0], {"ascii_only": True}, id="ascii"),
        pytest.param("capturing", Step.CAPTURE, (70, 20), {}, id="too_small"),
        pytest.param("solved", Step.RESULTS, SIZES[0], {"press": ("v",)}, id="second_results_page"),
    ],
)
def test_variant(compare, name, step, size, options):
    assert compare(story()[name], step, size, **options)


@pytest.mark.sample(5)
@pytest.mark.parametrize("size", SIZES, ids=["120x36", "80x24"])
@pytest.mark.parametrize("state", ["stopped", "diverged", "stale", "lost", "moving"])
def test_fault_states(compare, state, size):
    picture = {
        "stopped": stopped,
        "diverged": diverged,
        "stale": stale,
        "lost": lost,
        "moving": lambda s: busy(s, TaskKind.AUTOMATIC, moves=True),
    }[state](story()["capturing"])
    assert compare(picture, Step.CAPTURE, size)


@pytest.mark.parametrize("size", SIZES, ids=["120x36", "80x24"])
def test_dialog_leaves_strip_and_rail_visible(compare, size):
    assert compare(story()["ticked"], Step.MODES, size, press=("a",))


def test_ascii_theme_replaces_special_characters():
    plain = look("sarcal-dark", ascii_only=True)
    assert plain.text("placement ±5 mm") == "placement +-5 mm"
    assert plain.text("✗ excluded · ✕ \N{MINUS SIGN}1") == "x excluded . x -1"
