"""Screens of each step in both sizes, dark and without colour. Look before you update them."""

from itertools import product

import pytest
from rich.color import Color, ColorSystem

from operator_app.session.ui.snapshot import TaskKind
from operator_app.session.ui.steps import Step
from operator_app.tui.app import SarcalApp
from operator_app.tui.theme import DARK, LIGHT, NO_COLOUR, look, themes
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
            app.step = step
            app.main.go_to(step)
            await pilot.pause()
            app.poll()
            await pilot.pause()

        return snap_compare(app, terminal_size=size, run_before=show, press=press)

    return compare_screen


def luminance(colour, system):
    shown = [c / 255.0 for c in colour.downgrade(system).get_truecolor()]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in shown]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


@pytest.mark.parametrize("system", [ColorSystem.TRUECOLOR, ColorSystem.EIGHT_BIT])
@pytest.mark.parametrize("theme", [DARK, LIGHT])
def test_text_has_contrast(theme, system):
    (chosen,) = (t for t in themes() if t.name == theme)
    styles = look(theme, ascii_only=False).styles
    for ground, role in product(
        (chosen.background, chosen.panel), ("text", "dim", "accent", "warn", "alarm")
    ):
        pair = (luminance(c, system) for c in (Color.parse(ground), styles[role].color))
        low, high = sorted(pair)
        assert (high + 0.05) / (low + 0.05) >= 4.5, (ground, role)


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
