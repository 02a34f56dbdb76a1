"""Texts of panels and messages: in full where there is room, and only characters that a terminal shows."""

import threading
import unicodedata
from dataclasses import replace
from datetime import datetime, timedelta

import numpy as np
import pytest

from hardware.arm import Fault, JointMode
from operator_app.calibration.acceptance import Verdict
from operator_app.calibration.tool_accuracy import HeldOffset
from operator_app.config.procedure_file import load_procedure
from operator_app.headless.plain_messages import describe
from operator_app.report.subject import facts_on
from operator_app.report.text import facts_text
from operator_app.session.ui.next_action import next_action
from operator_app.session.ui.snapshot import Level, Message, SessionSnapshot, TaskKind
from operator_app.session.ui.steps import Step
from operator_app.tui.app import SarcalApp
from operator_app.tui.dialogs import Read
from operator_app.tui.main_screen import Footer, MainScreen, detail
from operator_app.tui.steps.capture import PosesPanel, ProgressPanel, QualityPanel, StillPanel
from operator_app.tui.steps.connect import NodesPanel
from operator_app.tui.steps.export import RecordPanel
from operator_app.tui.steps.fixture import ChecksPanel, PlacementPanel
from operator_app.tui.steps.modes import PlanPanel
from operator_app.tui.steps.results import ResultsPlot, VerdictPanel
from operator_app.tui.widgets.list_panel import JointTable
from solver.diagnostics.cross_validation import CommonShift
from tests.oracles.still_runner import StaticSource
from tests.oracles.story import busy, lost, stale, stopped, story, tripped, with_condition_above


def lines_of(panel, picture, width: int, height: int) -> list[str]:
    return ["".join(text for text, _ in row) for row in panel._build(picture, width, height)]


@pytest.mark.parametrize("width", [98, 80])
def test_verdict_counts_notes_and_shows_accuracy(width):
    s = story()["solved"]
    assert (s.solution.verdict, len(s.solution.warnings)) == (Verdict.ACCEPTED, 2)
    first, row, *_ = lines_of(VerdictPanel(), s, width, 7)
    assert first == " ✓ ACCEPTED · 2 notes"
    figures = facts_on(s).json["hand_accuracy_mm"]
    words = row.replace(",", "").split()
    for name in ("before", "after"):
        assert float(words[words.index(name) - 2]) == pytest.approx(figures[name]["rms"], rel=0.01)
    assert len(row) <= width
    fixed = HeldOffset(name="theta_off_1", value_rad=0.0, rate_m_per_rad=0.3)
    accuracy = replace(s.solution.accuracy, holds_for=(fixed,))
    s = replace(s, solution=replace(s.solution, accuracy=accuracy))
    assert " as fixed" in " ".join(lines_of(VerdictPanel(), s, width, 7))


@pytest.mark.parametrize("height", [5, 6, 7, 8])
def test_verdict_counts_the_notes_that_do_not_fit(height):
    s = with_condition_above(with_condition_above(story()["solved"], 20.0), 30.0)
    notes, rows = len(s.solution.warnings), lines_of(VerdictPanel(), s, 98, height)
    assert len(rows) == height
    assert rows[0].endswith(f"{notes} notes")
    shown = sum(row.startswith(" · ") for row in rows)
    assert shown == notes or rows[-1] == f"   {notes - shown} more (v)"
    reasons = tuple(note.text for note in s.solution.warnings)
    refused = replace(s, solution=replace(s.solution, reasons=reasons))
    _, reason, *_, last = lines_of(VerdictPanel(), refused, 98, height)
    assert (reason[:3], last[-9:]) == (" ■ ", " more (v)")


def test_unreachable_plan_is_stated():
    s = story()["connected"]
    s = replace(s, forecast=replace(s.forecast, reachable=np.zeros_like(s.forecast.reachable)))
    rows = " ".join(" ".join(lines_of(ChecksPanel(), s, 40, 30)).split())
    assert "no pose of the plan can be reached" in rows
    assert "predicted" not in rows
    plain = " ".join(describe(Step.FIXTURE, s))
    assert "no pose of the plan can be reached" in plain
    assert "condition number" not in plain


def test_steps_of_a_resumed_session_show_its_result_before_the_arm_is_connected():
    s = replace(story()["solved"], solution=None)
    assert (detail(Step.CALIBRATE, s), detail(Step.RESULTS, s)) == ("implicit", "accepted")


@pytest.mark.parametrize("width", [98, 80])
def test_node_in_fault_shows_its_code(width):
    s = tripped(story()["connected"])
    fault = Fault(node=4, joint=4, code=0x8311, text="excess torque", sync_count=0)
    s = replace(s, arm=replace(s.arm, faults=(fault,)))
    rows = lines_of(NodesPanel(), s, width, 12)
    assert [row.partition("■ ")[2] for row in rows if "■" in row] == ["fault 8311h: excess torque"]
    assert max(map(len, rows)) <= width


async def test_every_panel_names_the_same_verdict(still):
    """Accepted with warnings is another verdict than accepted with notes."""
    s = story()["solved"]
    for causes, words, short, title in (
        ((), "accepted", "accepted", "Notes"),
        (s.solution.warnings[:1], "accepted, with warnings", "with warnings", "Warnings"),
    ):
        adjudication = replace(s.solution.adjudication, causes=causes)
        now = replace(s, solution=replace(s.solution, adjudication=adjudication))
        assert f"the calibration is {words}:" in next_action(Step.RESULTS, now).hint
        assert detail(Step.RESULTS, now) == short
        async with still(now, step=Step.RESULTS) as d:
            plots = d.app.main.query_one(ResultsPlot)
            while not str(plots.border_title).startswith("Verdict in full"):
                assert plots.page < plots.count - 1
                await d.press("v")
            assert ("▲" in d.text("#results-plot")) == (title == "Warnings")
        assert any(row.startswith(f"{title[:-1]}: ") for row in describe(Step.RESULTS, now))
        mark = "\n! " in facts_text(facts_on(now))
        assert mark == (title == "Warnings")


def test_condition_limit_is_that_of_the_procedure():
    strict = replace(story()["capturing"].procedure.acceptance, scaled_condition_number=20.0)
    for name, panel, step, width in (
        ("connected", ChecksPanel(), Step.FIXTURE, 98),
        ("capturing", QualityPanel(), Step.CAPTURE, 60),
    ):
        s = replace(story()[name], procedure=replace(story()[name].procedure, acceptance=strict))
        words = " ".join(lines_of(panel, s, width, 30) + describe(step, s))
        assert "20" in words
        assert "100" not in words


@pytest.mark.parametrize("height", [9, 14, 30, 60])
def test_ranking_counts_what_does_not_fit(height):
    s = story()["ticked"]
    all_rows, rows = (lines_of(PlanPanel(), s, 66, h) for h in (200, height))
    worst = lines_of(PlanPanel(), replace(s, selected_joints=s.ranked[-1].drives), 66, height)
    assert any(row.startswith(" ▌") for row in worst), "the marked pair is always shown"
    assert len(rows) <= height
    if len(all_rows) <= height:
        assert rows == all_rows
    else:
        assert rows[:-1] == all_rows[: len(rows) - 1]
        shown = sum(row[3:5].strip().isdigit() for row in rows[:-1])
        assert shown + int(rows[-1].split()[0]) == len(s.ranked)
        assert all_rows[len(rows) - 1][3:5].strip().isdigit()


def test_remaining_time_ignores_operator_pauses():
    s = busy(story()["captured"], TaskKind.AUTOMATIC, moves=True)
    first, poses = datetime.fromisoformat(s.state.poses[0].utc), s.state.poses[:10]
    seconds = [4.0 * k + (600.0 if k >= 6 else 0.0) for k in range(10)]
    poses = tuple(
        replace(p, utc=(first + timedelta(seconds=t)).isoformat(), excluded="")
        for p, t in zip(poses, seconds, strict=True)
    )
    s = replace(s, state=replace(s.state, poses=poses))

    def progress_after(task_s, s=s):
        task = replace(s.task, started_s=s.now_s - task_s)
        return lines_of(ProgressPanel(), replace(s, task=task), 66, 1)[0]

    for task_s in (3600.0, 15.0):  # all poses are of this task, or four
        assert f"0:{4 * (s.required_poses - 10)} min left" in progress_after(task_s)
    assert "min left" not in progress_after(5.0), "most poses precede this task"
    planned = replace(s.procedure, capture=replace(s.procedure.capture, strategy="planned"))
    assert "exploring" in progress_after(3600.0, replace(s, procedure=planned))


def test_target_of_a_planned_capture_is_not_the_waypoint_of_a_single_move():
    s = story()["capturing"]
    planned = replace(s.procedure, capture=replace(s.procedure.capture, strategy="planned"))
    s = replace(s, procedure=planned)
    waypoint = f"waypoint {s.next_waypoint + 1}: "

    def target(s):
        return lines_of(StillPanel(), s, 98, 2)[0].removeprefix(" Target    ")

    assert target(s).startswith(f"a: chosen by the plan; g: {waypoint}")
    running = busy(s, TaskKind.AUTOMATIC, moves=True)
    assert waypoint not in target(running)
    assert "being planned" in target(replace(running, task=replace(running.task, planning=True)))
    assert target(busy(s, TaskKind.MOVE, moves=True)).startswith(waypoint)


async def test_fixture_step_shows_the_whole_placement_and_all_ranges_of_a_ball(still):
    s, ball = story()["connected"], load_procedure("ball")
    s = replace(s, procedure=replace(s.procedure, fixture=ball.fixture))
    assert max(map(len, lines_of(PlacementPanel(), s, 66, 6))) <= 66
    async with still(s, step=Step.FIXTURE) as d:
        await d.settle()
        assert d.app.main.query_one("#checklist").content_size.height < 11, "no empty rows"
        for row in ("ground_x", "ground_y", "ground_z", "tip_x", "tip_y", "tip_z", "±", "Unknowns"):
            assert row in d.words("#placement")
        assert all(f"J{j} " in d.words("#checks").partition("ranges")[2] for j in range(1, 8))
        assert ball.fixture.checklist[-1].split()[-1] in d.words("#checklist")
    s = replace(s, procedure=replace(s.procedure, fixture=load_procedure("open_loop").fixture))
    async with still(s, step=Step.FIXTURE, size=(80, 24)) as d:
        room = d.app.main.query_one("#placement").content_size.height
        assert "Unknowns" in d.text("#placement").splitlines()[:room][-1]


def test_target_of_four_drives_is_shown_in_full():
    s = story()["capturing"]
    s = replace(s, plan=(dict.fromkeys((1, 5, 6, 7), -1.5),) * len(s.plan))
    rows = lines_of(StillPanel(), s, 66, 3)
    assert (len(rows), "".join(rows[:2]).count("-85.94")) == (3, 4)
    assert "…" not in "".join(rows)
    assert not rows[0].rstrip().endswith("J7"), "a joint is not parted from its angle"
    assert len(lines_of(StillPanel(), s, 80, 2)) == 2


@pytest.mark.parametrize("change", [stale, lost])
def test_old_data_are_not_shown_as_standstill(change):
    old = replace(change(story()["capturing"]), motion=story()["capturing"].motion)
    assert "no fresh data" in lines_of(StillPanel(), old, 66, 3)[-1]


def test_step_list_names_drives_that_are_on_and_otherwise_asks_to_apply():
    s = story()["modes"]
    assert detail(Step.MODES, s) == "J1 J5 drive"
    for other in (stopped(s), tripped(s), replace(s, arm=None)):
        assert detail(Step.MODES, other) == "apply again"
    for joints, words in (((2,), "J2 drives"), ((1, 5, 6, 7), "J1 J5 J6 J7")):
        modes = tuple(JointMode.POSITION if j in joints else JointMode.FREE for j in range(1, 8))
        by_joint = zip(s.arm.joints, modes, strict=True)
        arm_joints = tuple(replace(j, mode=mode) for j, mode in by_joint)
        arm, state = replace(s.arm, joints=arm_joints), replace(s.state, modes=modes)
        assert detail(Step.MODES, replace(s, arm=arm, state=state)) == words


def test_first_pose_of_a_placement_is_marked():
    s = story()["captured"]
    poses = tuple(replace(p, placement=1 if p.number <= 4 else 2) for p in s.state.poses)
    rows = lines_of(PosesPanel(), replace(s, state=replace(s.state, poses=poses)), 66, 30)
    marked = [row for row in rows if "placement 2 begins" in row]
    assert [int(row.split()[0].lstrip("▌") or row.split()[1]) for row in marked] == [5]


def test_trend_covers_all_poses():
    s = story()["capturing"]
    values = [6000.0, 900.0, *(400.0 * 0.95**k for k in range(48))]
    live = replace(s.live, history=tuple(enumerate(values, 3)), scaled_condition_number=values[-1])
    trend, first, bars, last = lines_of(QualityPanel(), replace(s, live=live), 29, 13)[1].split()
    assert (trend, first, last, bars[0], bars[-1]) == ("trend", "6000", "35.9", "█", "▁")
    assert len(set(bars)) > 4
    assert list(bars) == sorted(bars, reverse=True)


async def test_result_pages_fit_a_small_terminal_with_titles(still):
    async with still(story()["solved"], step=Step.RESULTS, size=(80, 24)) as d:
        plots = d.app.main.query_one(ResultsPlot)
        titles = []
        d.app.poll()
        assert "view 1/12" in d.text("#row")
        for _ in range(1, d.app.main.view.place[1]):
            await d.press("v")
            title, *rows = d.text("#results-plot").splitlines()
            titles.append(title.strip())
            if title.strip().startswith("Tool position uncertainty"):
                rms_mm = 1e3 * story()["solved"].solution.hand.rms
                assert f"{rms_mm:.3g}" in d.text("#results-plot")
            assert f"{title.strip()} (v: next)" == str(plots.border_title).replace("\\[", "[")
            assert max(map(len, rows)) <= 80, title
        assert titles[0] == "Residuals"
        assert len(set(titles)) == len(titles) == plots.count
    async with still(story()["solved"], step=Step.RESULTS, size=(120, 36)) as d:
        assert "Residuals" not in d.text("#results-plot")  # it is in the frame


async def test_result_page_longer_than_the_panel_says_so_and_scrolls(still):
    s = story()["solved"]
    for limit in (20.0, 25.0, 30.0, 33.0):
        s = with_condition_above(s, limit)
    async with still(s, step=Step.RESULTS, size=(80, 24)) as d:
        while "in full" not in d.text("#results-plot"):
            await d.press("v")
        hidden = d.text("#results-plot").splitlines()[-1]
        assert hidden.endswith(" more below (Down)")
        await d.press(*["down"] * int(hidden.split()[0]))
        assert d.text("#results-plot").endswith(" more above (Up)")


def test_verification_verdict_precedes_its_figures():
    s = story()["verified"]
    rows = lines_of(RecordPanel(), s, 80, 3)
    assert rows[0].startswith(" Verified   ✓ 3 new poses, as expected: ")
    assert not any("…" in row for row in rows)
    shift = CommonShift(subject="3", size=np.deg2rad(0.5), sigma=1e-4, chi2=50.0, threshold=9.0)
    shifted = replace(s, verification=replace(s.verification, shift=shift))
    rows = lines_of(RecordPanel(), shifted, 80, 6)
    assert "worse than expected (joint 3 reads 0.50" in " ".join(" ".join(rows).split())


@pytest.mark.parametrize(("width", "age"), [(80, " 240 ms"), (66, "")])
def test_age_of_stale_joint_has_its_unit_or_is_omitted(width, age):
    rows = lines_of(JointTable(), stale(story()["capturing"]), width, 8)
    assert rows[5].endswith(f"┤ ▲ STALE{age}")
    assert max(map(len, rows)) <= width
    s = story()["capturing"]
    joints = tuple(replace(j, torque_nm=99.0) for j in s.arm.joints)
    loaded = replace(s, arm=replace(s.arm, joints=joints))
    assert "+99.0▲" in lines_of(JointTable(), loaded, width, 8)[7]


@pytest.mark.parametrize("ascii_only", [False, True])
async def test_focused_panel_is_marked_on_a_small_terminal(still, ascii_only):
    picture = story()["capturing"]
    async with still(picture, step=Step.CAPTURE, size=(80, 24), ascii_only=ascii_only) as d:
        joints = d.app.main.query_one("#capture-joints")
        assert joints.content_size.height >= 8  # a heading and seven joints
        assert joints.styles.outline_right[0] == ""
        await d.press("tab")
        assert d.app.main.focused is joints
        assert joints.styles.outline_right[0] == ("ascii" if ascii_only else "vkey")
        assert joints.content_size.height >= 8


async def test_click_on_the_footer_before_a_session_is_open_does_nothing():
    opened = threading.Event()

    class SlowSource(StaticSource):
        def new(self, procedure=None):
            opened.wait(60.0)
            return super().new(procedure)

    app = SarcalApp(lambda: SlowSource(story()["start"]))
    async with app.run_test() as pilot:
        try:
            while not isinstance(app.screen, MainScreen) or not app.main.footer.size.area:
                await pilot.pause(0.01)
            await pilot.click(Footer)
            await pilot.pause()
            assert app.picture is None
        finally:
            opened.set()


async def test_clicks_on_view_and_log_do_not_end_a_motion(still):
    moving = busy(story()["capturing"], TaskKind.AUTOMATIC, moves=True)
    async with still(moving, step=Step.CAPTURE, size=(80, 24)) as d:
        assert "view 1/3" in d.text("#row")
        await d.pilot.click("#row", offset=(d.text("#row").index("view"), 0))
        await d.until(lambda: d.app.main.view.view == 1, "next view")
        await d.pilot.click("#row", offset=(d.text("#row").index("✓3"), 0))
        await d.until(lambda: d.app.step is Step.MODES, "another step")
        # Any key would end the motion: the log names none.
        assert "l shows" not in d.text("#log")
        await d.pilot.click("#log", offset=(3, 0))
        await d.until(lambda: isinstance(d.app.screen, Read), "all messages")
        assert d.runner.cancels == 0


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
    async with drive(size=size, step=Step.FIXTURE) as d:
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


HOSTILE = "a\x1b[2J\x1b]0;owned\x07b\x9b31mc\u202edlo\u2066x\ry\nz\u2028"
CONTROL_CATEGORIES = ("Cc", "Cf", "Cs", "Zl", "Zp")


def hostile(s: SessionSnapshot) -> SessionSnapshot:
    nodes = tuple(replace(node, device_name=HOSTILE, role=HOSTILE) for node in s.identity.nodes)
    identity = replace(s.identity, model=HOSTILE, serial_number=HOSTILE, nodes=nodes)
    poses = tuple(
        replace(pose, note=HOSTILE, excluded=HOSTILE if pose.excluded else "")
        for pose in s.state.poses
    )
    state = replace(s.state, serial_number=HOSTILE, poses=poses)
    messages = tuple(
        Message(number=k, time="12:00:00", level=level, text=HOSTILE)
        for k, level in enumerate(Level, 1)
    )
    return replace(
        s, identity=identity, state=state, messages=messages, bus=HOSTILE, wiggle=HOSTILE,
        folder=s.folder / HOSTILE.replace("/", ""),
    )  # fmt: skip


@pytest.mark.sample(1)
@pytest.mark.parametrize("ascii_only", [False, True], ids=["all characters", "ascii"])
async def test_screens_contain_no_control_characters(still, ascii_only):
    snapshots = story()
    async with still(
        hostile(snapshots["connected"]), step=Step.CONNECT, ascii_only=ascii_only
    ) as d:
        shown = ""
        for step, name in ((Step.CONNECT, "connected"), (Step.CAPTURE, "capturing"),
                          (Step.RESULTS, "solved"), (Step.EXPORT, "written")):  # fmt: skip
            await d.show(hostile(snapshots[name]), step)
            if step is Step.CAPTURE:
                await d.press("n")
            strips = d.app.screen._compositor.render_strips()
            shown += "".join(segment.text for strip in strips for segment in strip)
            if d.app.screen is not d.app.main:
                await d.press("escape")
        assert "owned" in shown
        assert {c for c in shown if unicodedata.category(c) in CONTROL_CATEGORIES} == set()
