"""Keys of every step: the task that they submit, or what the screen shows."""

import html
import re
from dataclasses import replace
from threading import Event

import pytest
from textual import events
from textual.widgets import Button, Input, OptionList

from operator_app.session.ui.snapshot import TaskKind
from operator_app.session.ui.steps import Step
from operator_app.session.ui.user_interface import OneOf, Typed, YesNo
from operator_app.tui.app import SarcalApp
from operator_app.tui.dialogs import Ask, Choose, Confirm
from tests.operator_app.tui.conftest import PATIENCE_S
from tests.oracles.still_runner import StaticSource, entry
from tests.oracles.story import busy, real, stale, story

SUBMITTED = [
    # step, snapshot, key, submitted task
    *((Step.CONNECT, "start", key, TaskKind.CONNECT) for key in ("c", "enter")),
    (Step.FIXTURE, "connected", "k", TaskKind.CHECK),
    (Step.MODES, "modes", "w", TaskKind.WIGGLE),
    *((Step.CAPTURE, "capturing", key, TaskKind.AUTOMATIC) for key in ("a", "enter")),
    *((Step.CAPTURE, "capturing", key, TaskKind.MOVE) for key in "gb"),
    (Step.CAPTURE, "capturing", "c", TaskKind.CAPTURE),
    *((Step.CAPTURE, "capturing", key, TaskKind.NOTE) for key in "ux"),
    *((Step.CALIBRATE, "captured", key, TaskKind.CALIBRATE) for key in ("s", "enter")),
    *((Step.EXPORT, "solved", key, TaskKind.EXPORT) for key in ("w", "enter", "r")),
    (Step.CAPTURE, "modes", "H", TaskKind.HOLD),
    # The second y confirms.
    (Step.EXPORT, "solved", "yy", TaskKind.VERIFY),
]


async def test_key_submits_its_task(still):
    async with still(story()["start"]) as d:
        for step, name, key, kind in SUBMITTED:
            await d.show(story()[name], step)
            await d.press(*([key] if key == "enter" else key))
            assert [k for k, _ in d.runner.asked] == [kind], (step, name, key)


async def test_too_small_window_accepts_only_stop_and_quit(still):
    async with still(story()["start"], size=(60, 20)) as d:
        await d.press("enter", "c")
        await d.show(story()["connected"], Step.FIXTURE)
        before = d.s.ticked
        await d.press("enter", "k")
        assert (d.runner.asked, d.runner.picture.ticked) == ([], before)
        assert "q Quit" in d.text("#footer")
        await d.press("f8", "q")
        assert d.runner.stops == 1
        assert isinstance(d.app.screen, Confirm)


REFUSALS = [
    # step, snapshot, key, words of the hint
    (Step.CONNECT, "connected", "c", "already connected"),
    (Step.CONNECT, "start", "right_square_bracket", "no arm is connected"),
    (Step.CONNECT, "start", "2", "Fixture is closed: no arm is connected"),
    *((Step.CONNECT, "start", str(int(s)), f"{s.title} is closed") for s in list(Step)[2:]),
    (Step.CONNECT, "start", "o", "no other session"),
    (Step.CONNECT, "start", "space", "STOP: no arm is connected"),
    (Step.CONNECT, "connected", "R", "STOP is not latched"),
    (Step.CONNECT, "connected", "H", "the drives are off"),
    (Step.FIXTURE, "connected", "right_square_bracket", "check list are not ticked"),
    (Step.FIXTURE, "connected", "g", "g is not a key of this step"),
    (Step.MODES, "start", "p", "no ranking yet"),
    (Step.MODES, "ticked", "w", "modes are not set"),
    (Step.MODES, "start", "a", "no arm is connected"),
    (Step.CAPTURE, "captured", "a", "all 16 poses are captured"),
    *((Step.CAPTURE, "modes", key, "no pose yet") for key in "unx"),
    (Step.CAPTURE, "modes", "b", "no best pose yet"),
    (Step.CALIBRATE, "modes", "s", "0 of the 3 required poses"),
    *((Step.EXPORT, "captured", key, "no calibration") for key in "wuyr"),
]


async def test_refused_key_shows_the_reason(still):
    async with still(story()["start"]) as d:
        for step, name, key, words in REFUSALS:
            await d.show(story()[name], step)
            await d.press(key)
            d.app.poll()
            assert d.hint.startswith("▲ "), (step, name, key)
            assert words in d.hint, (step, name, key)
            assert (d.runner.asked, d.runner.stops) == ([], 0)
            assert d.app.step is step
        # The next action is shown again as soon as it is another one.
        await d.show(busy(story()["captured"], TaskKind.CALIBRATE, moves=False), Step.CALIBRATE)
        await d.press("s")
        assert d.hint == "▲ wait: calibrating"
        d.runner.picture = story()["captured"]
        await d.until(lambda: d.hint.startswith("Next Enter calibrates"))


async def test_stale_data_are_marked_and_delay_a_capture(still):
    async with still(stale(story()["capturing"]), step=Step.CAPTURE) as d:
        await d.press("c")
        await d.until(lambda: "data of joint 5 are 240 ms old" in d.hint)
        row = d.text("#capture-joints").splitlines()[5]
        assert "?" in row
        assert "▲ STALE" in row
        assert "+0.0" not in row
        assert "J5 STALE" in d.text("#strip")
        assert d.runner.asked == []
        await d.press("c")
        await d.show(story()["capturing"], Step.CAPTURE)
        await d.until(lambda: [k for k, _ in d.runner.asked] == [TaskKind.CAPTURE])


async def test_modes_are_applied_only_after_confirmation(still):
    async with still(story()["ticked"], step=Step.MODES) as d:
        await d.press("a", "enter")
        await d.press("a", "left", "right", "enter")
        assert d.runner.asked == []
        await d.press("a", "tab", "enter")
        await d.settle()
        assert [k for k, _ in d.runner.asked] == [TaskKind.MODES]
        await d.press("a", "y")
        await d.settle()
        assert len(d.runner.asked) == 2


async def test_real_arm_moves_only_after_confirmation(still):
    real_arm = real(story()["capturing"])
    real_arm = replace(real_arm, ticked=story()["capturing"].ticked, stop_tested=True)
    hand_guided = replace(real_arm, identity=replace(real_arm.identity, by_hand=True))
    async with still(real_arm, step=Step.CAPTURE) as d:
        for key in ("enter", "a"):
            await d.show(real_arm, Step.CAPTURE)
            await d.until(lambda: "(it asks first)" in d.hint, "hint")
            await d.press(key, "enter")
            assert d.runner.asked == []
            # Quitting while the question is open starts no motion.
            await d.press(key, "q", "y")
            assert d.runner.asked == []
            await d.press(key, "y")
            assert [k for k, _ in d.runner.asked] == [TaskKind.AUTOMATIC]
        await d.show(hand_guided, Step.CAPTURE)
        await d.until(lambda: "(it asks first)" not in d.hint, "no question")
        await d.press("a")
        assert [k for k, _ in d.runner.asked] == [TaskKind.AUTOMATIC]


async def test_upload_needs_the_serial_number(still):
    async with still(story()["written"], step=Step.EXPORT) as d:
        await d.press("u", *"SDA-0009", "enter")
        await d.settle()
        assert isinstance(d.app.screen, Ask)
        assert d.runner.asked == []
        await d.press("escape", "u", *"SDA-0001", "enter")
        await d.settle()
        assert [k for k, _ in d.runner.asked] == [TaskKind.UPLOAD]


async def test_any_key_ends_a_motion_and_only_z_a_calibration(still):
    moving = busy(story()["capturing"], TaskKind.AUTOMATIC, moves=True)
    async with still(moving) as d:
        for key in ("z", "x", "enter", "escape", "down", "7", "q", "a", "tab", "ctrl+p", "é"):
            await d.show(moving, Step.CAPTURE)
            assert "ANY KEY STOPS" in d.text("#banner")
            await d.press(key)
            assert (d.runner.cancels, d.runner.stops, d.runner.asked) == (1, 0, []), key
            assert d.app.screen is d.app.main
            assert d.app.step is Step.CAPTURE
        await d.show(busy(story()["captured"], TaskKind.CALIBRATE, moves=False), Step.CALIBRATE)
        for key, cancels in (("v", 0), ("z", 1)):
            await d.press(key)
            assert d.runner.cancels == cancels, key


async def test_brackets_and_digits_change_the_step(still):
    async with still(story()["solved"], step=Step.EXPORT) as d:
        for step in (*reversed(list(Step)[:-1]), Step.CONNECT):
            await d.press("left_square_bracket")
            assert d.app.step is step
        for step in list(Step)[1:]:
            await d.press("right_square_bracket")
            assert d.app.step is step
        for number in range(1, 8):
            await d.show(story()["solved"], Step.CAPTURE)
            await d.press(str(number))
            assert d.app.step == number
        assert d.runner.asked == []


async def test_toggled_modes_show_their_risk_before_applying(still):
    async with still(story()["ticked"], step=Step.MODES) as d:
        before = d.s.selected_joints
        await d.press("down", "f")
        await d.until(lambda: "until a drive trips" in d.words("#modes-plan"))
        assert 2 in d.s.selected_joints
        await d.press("a")
        await d.until(lambda: "until a drive trips" in d.hint)
        await d.press("f", "up", "f")
        await d.until(lambda: "would sag" in d.words("#modes-plan"))
        await d.press("a")
        await d.until(lambda: "would sag" in d.hint)
        await d.press("p")
        best = story()["ticked"].ranked[0].drives
        assert d.s.selected_joints == best != before
        assert d.runner.asked == []


async def test_real_arm_ticks_check_list_items_singly(still):
    picture = replace(real(story()["connected"]), stop_tested=True)
    async with still(picture, step=Step.FIXTURE) as d:
        items = len(picture.procedure.fixture.checklist)
        for k in range(items):
            assert f"{items - k} left" in d.hint
            await d.press("enter")
            d.app.poll()
        assert d.runner.picture.ticked == frozenset(range(items))
        assert len(d.runner.asked) == items
        await d.press("x")
        assert len(d.runner.picture.ticked) == items - 1
    async with still(picture, step=Step.FIXTURE, size=(80, 24)) as d:
        for key in ("v", "x", "x"):
            await d.press(key)
            d.app.poll()
        assert not d.runner.picture.ticked, "a hidden list stays at its item"


async def test_real_arm_needs_the_stop_test_first(still):
    async with still(real(story()["connected"]), step=Step.CONNECT) as d:
        await d.press("2")
        await d.until(lambda: "hardware stop is not tested" in d.hint)
        await d.press("t")
        d.app.poll()
        assert d.runner.picture.stop_tested
        await d.press("2")
        assert d.app.step is Step.FIXTURE
        assert "REAL ARM" in d.text("#banner")


async def test_estimator_and_unsensed_joints_cycle_and_arrows_move_the_mark(still):
    async with still(story()["captured"], step=Step.CALIBRATE) as d:
        first = d.runner.picture.estimator
        await d.press("e")
        assert d.runner.picture.estimator != first
        await d.press("e")
        assert d.runner.picture.estimator == first
        unsensed = []
        for _ in range(4):
            await d.press("j")
            unsensed.append(d.runner.picture.unsensed_joints)
        assert unsensed == [(6,), (7,), (6, 7), ()]
        await d.show(story()["captured"], Step.CAPTURE)
        view = d.app.main.view
        newest = view.marked_pose(d.s)
        await d.press("down", "down")
        assert view.marked_pose(d.s) == newest - 2
        await d.press("up")
        assert view.marked_pose(d.s) == newest - 1


async def test_views_and_themes_cycle(still):
    async with still(story()["capturing"], step=Step.CAPTURE, size=(80, 24)) as d:
        panels, themes = [], set()
        for _ in range(4):
            panels.append(tuple(p.id for p in d.app.main.view.query(".panel") if p.display))
            await d.press("v")
        assert len(set(panels[:3])) == 3
        assert panels[3] == panels[0]
        for _ in range(3):
            await d.press("T")
            themes.add(d.app.theme)
        assert len(themes) == 3


async def test_session_choice_defaults_to_cancel(still):
    earlier = entry(story()["capturing"])
    async with still(story()["uploaded"], step=Step.EXPORT, entries=(earlier,)) as d:
        await d.until(lambda: d.app.screen is not d.app.main, "the offer to resume")
        offer = await d.dialog_text()
        assert f"{len(earlier.state.used_poses)} poses" in offer
        assert "of SDA-0001 (procedure " in offer
        assert "New session" in str(d.app.screen.query_one("#cancel").label)
        await d.press("escape")
        await d.press("o")
        assert isinstance(d.app.screen, Choose)
        await d.press("enter")
        assert d.app.source.resumed_references == []
        await d.press("o", "down", "enter")
        await d.until(lambda: d.app.source.resumed_references == [earlier.folder.name], "resumed")


async def test_new_session_and_chosen_procedure_start_at_connect(still):
    async with still(story()["connected"], step=Step.FIXTURE) as d:
        before = d.app.source.begun
        await d.press("p")
        assert isinstance(d.app.screen, Choose)
        await d.press("enter")
        assert (d.app.source.begun, d.app.step) == (before, Step.FIXTURE)
        await d.press("p", "down", "down", "down", "enter")
        await d.until(lambda: d.app.step is Step.CONNECT, "begun")
        assert d.app.source.begun == before + 1
        assert d.app.source.requested_procedure == "hinge_planned"
        await d.show(story()["uploaded"], Step.EXPORT)
        await d.press("N", "y")
        await d.until(lambda: d.app.step is Step.CONNECT, "begun")
        assert d.app.source.begun == before + 2


@pytest.mark.parametrize("name", ["start", "capturing"])
async def test_quit_asks_only_when_connected(still, name):
    async with still(story()[name], step=Step.CONNECT) as d:
        await d.press("q", *("" if name == "start" else "y"))
        await d.settle()
        assert d.app.return_value == "left"


async def test_clicks_act_like_keys(still):
    async with still(story()["capturing"], step=Step.CAPTURE) as d:
        await d.pilot.click("#strip", offset=(3, 0))
        assert d.runner.stops == 1
        await d.pilot.click("#rail", offset=(3, 0))
        assert d.app.step is Step.CONNECT
        await d.pilot.click("#footer", offset=(d.text("#footer").index("Quit"), 0))
        assert isinstance(d.app.screen, Confirm)


@pytest.mark.parametrize("size", [(120, 36), (80, 24)])
async def test_remounting_instructions_fit_the_screen(still, size):
    async with still(story()["captured"], step=Step.CAPTURE, size=size) as d:
        await d.press("M")
        assert isinstance(d.app.screen, Confirm)
        svg = html.unescape(d.app.export_screenshot(simplify=True))
        shown = " ".join(re.sub(r"<[^>]*>|[┃│]", " ", svg).replace("\xa0", " ").split())
        for words in ("placement 2", "drives are still on", "1. Secure the arm", "2. Take", "fixture off the table",
                    "3. Mount", "±30 mm", "4. Move the arm to its home", "5. Only then",
                    "Release the arm"):  # fmt: skip
            assert words in shown


@pytest.mark.parametrize(
    ("question", "widget"),
    [
        (YesNo(title="Question", text="Go on?", yes="Yes"), Button),
        (Typed(title="Question", text="Which reason?"), Input),
        (OneOf(title="Question", text="Which one?", options=(("a", "A"),)), OptionList),
    ],
    ids=("confirm", "ask", "choose"),
)
async def test_dialog_opened_in_a_terminal_in_the_background_has_the_focus(still, question, widget):
    async with still(story()["start"]) as d:
        d.app._driver.process_message(events.AppBlur())
        await d.settle()
        d.app.interface.ask(question, print)
        await d.settle()
        d.app._driver.process_message(events.AppFocus())
        await d.settle()
        assert isinstance(d.app.screen.focused, widget)


async def test_while_the_program_loads_a_click_focuses_nothing():
    ready = Event()

    def slow_source():
        ready.wait(PATIENCE_S)
        return StaticSource(story()["start"])

    app = SarcalApp(slow_source)
    async with app.run_test() as pilot:
        await pilot.click("#middle")
        focused, strip = app.screen.focused, app.screen.query_one("#strip")
        ready.set()
        # Leaving while the main screen is mounted is another matter.
        while not app.screen.query("#body"):
            await pilot.pause()
        assert strip.shown
        assert focused is None
