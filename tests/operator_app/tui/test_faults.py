"""Faults while the app runs: the arm is stopped, the journal complete, the remedy on the screen."""

import signal

import pytest

from hardware.errors import BusError, ControlDenied, DriveDiverged, NodeMissing
from operator_app.messages.errors import stopped_words
from operator_app.session.store.journal import read_journal
from operator_app.session.ui.snapshot import DataState, Level, TaskKind
from operator_app.session.ui.steps import Step
from operator_app.tui.dialogs import Confirm
from tests.oracles.journal_events import event_data


async def test_failed_connection_names_a_remedy_and_can_be_retried(drive, source):
    async with drive() as d:
        source.arm.connect_error = ControlDenied(127)
        await d.run("enter")
        assert not d.s.connected
        assert "ask the other operator" in d.s.messages[-1].text.lower()
        assert d.s.alarms == d.s.messages[-1:]
        await d.run("enter")
        assert d.s.connected
        assert d.s.alarms == ()


async def test_lost_arm_can_be_reconnected(drive, source):
    async with drive(step=Step.CAPTURE) as d:
        await d.press("1")
        source.arm.stop_answering_since(1.2)
        await d.until(lambda: "Connect again" in d.text("#footer"), "offered")
        source.arm.connect_error = NodeMissing((3,))
        await d.press("enter")
        await d.until(lambda: "no answer from node 3" in d.s.messages[-1].text.lower(), "refused")
        await d.idle()
        assert d.s.data is DataState.NONE
        assert "no arm is connected" in d.text("#nodes")
        assert "Connect" in d.text("#footer")
        source.arm.reset_stop()
        source.arm.answer_again()
        source.arm.stop_answering_since(1.2)
        await d.press("enter")
        source.arm.answer_again()
        await d.until(lambda: source.arm.closed == 1 and source.arm.connected, "connected again")
        await d.idle()
        await d.until(lambda: d.s.data is DataState.FRESH, "fresh")
        assert (source.arm.closed, source.arm.connected) == (1, True)
        assert not d.s.drives_ready


async def test_tripped_drive_is_named_and_reset(drive, source):
    async with drive(step=Step.CAPTURE) as d:
        source.arm.trip(4)
        await d.until(lambda: "FAULT" in d.text("#strip"), "fault shown")
        await d.press("c")
        await d.until(lambda: "fault" in d.hint)
        await d.run("R")
        assert "FAULT" not in d.text("#strip")


async def test_stop_reaches_the_arm_while_the_worker_is_busy(drive, source):
    source.pace_s = 0.005
    async with drive(step=Step.CAPTURE) as d:
        await d.press("a")
        await d.until(lambda: d.s.task is not None and d.s.task.moves, "moving")
        await d.press("f8")
        assert len(source.arm.stops) == 1
        await d.idle()
        await d.until(lambda: d.s.stopped, "latched")
        await d.until(lambda: "all 7 drives stopped" in d.text("#banner"), "acknowledged")
        # One alarm only, though the task was ended too.
        (alarm,) = d.s.alarms
        assert "STOP sent to all drives" in alarm.text
        # The reset starts no motion.
        before = d.s.arm.positions_rad.copy()
        await d.run("R")
        await d.until(lambda: not d.s.stopped, "reset")
        assert not d.s.drives_ready
        assert abs(d.s.arm.positions_rad - before).max() < 0.02


async def test_cause_of_an_arm_stop_stays_visible(drive, source):
    async with drive(step=Step.CAPTURE) as d:
        await d.run("c")
        source.arm.diverge(5)
        await d.until(lambda: "STOPPED BY ITSELF joint 5 is +1300" in d.words("#banner"), "banner")
        await d.until(lambda: "Joint 5 is +1300 counts from its target" in d.words("#log"), "log")
        await d.idle()
        # A STOP and other keys leave the cause visible.
        assert "the arm stopped by itself" in d.hint
        await d.run("f8", "c")
        assert [m.text[:12] for m in d.s.alarms] == ["Joint 5 is +"]
        assert "Keep clear until the cause is known" in d.words("#log")
        (fault,) = event_data(d.s.folder, "sensor_fault")
        assert fault["joint"] == 5
        await d.run("R")
        assert d.s.alarms == ()
        assert "STOPPED" not in d.text("#banner")


@pytest.mark.sample(1)
@pytest.mark.parametrize("size", [(80, 24), (120, 36)], ids=["80x24", "120x36"])
async def test_alarms_are_shown_in_full_one_after_the_other(drive, source, size):
    first = stopped_words(str(DriveDiverged(5, 1294, 700)))
    second = "The disk is full. Free space on it, then go on"
    async with drive(size=size, step=Step.CAPTURE) as d:
        d.runner.say(Level.ALARM, first)
        d.runner.say(Level.ALARM, second)
        await d.until(lambda: f"1 of 2: {second} (A acknowledges)" in d.words("#log"), "newest")
        assert "Joint 5" not in d.words("#log")
        await d.press("A")
        await d.until(lambda: f"{first} (A acknowledges)" in d.words("#log"), "the one before")
        assert [a.text for a in d.s.alarms] == [first]
        # All joints stay visible.
        joints, log = d.app.main.query_one("#capture-joints"), d.app.main.log_lines
        assert joints.size.height >= 8  # a heading and seven joints
        assert joints.region.bottom <= log.region.y
        await d.press("A")
        await d.until(lambda: "A acknowledges" not in d.words("#log"), "gone")
        assert d.s.alarms == ()


@pytest.mark.campaign
async def test_long_alarm_is_shown_in_full_before_acknowledgement(drive, source):
    text = " ".join(f"word{k}" for k in range(120)) + ". Do what the last word says"
    async with drive(size=(80, 24)) as d:
        await d.to_step(Step.CAPTURE)
        d.runner.say(Level.ALARM, text)
        await d.until(lambda: "(A shows all of it)" in d.words("#log"), "marked")
        await d.press("A")
        await d.until(
            lambda: isinstance(d.app.screen, Confirm) and d.visible_dialog_text == text, "shown"
        )
        assert [a.text for a in d.s.alarms] == [text]
        await d.press("y")
        await d.until(lambda: d.s.alarms == (), "acknowledged")


async def test_counter_reset_leads_to_reconnection(drive, source):
    async with drive(size=(80, 24)) as d:
        await d.to_step(Step.MODES)
        source.arm.reads_rad[3] = 0.0
        await d.run("enter", "y")
        await d.until(lambda: "then connect again (A acknowledges)" in d.words("#log"), "alarm")
        assert "Enter goes to step 1" in d.hint
        source.arm.reads_rad.clear()  # the joint was homed
        await d.press("enter")
        assert d.app.step is Step.CONNECT
        assert "Enter connects again" in d.hint
        closed_before = source.arm.closed
        await d.run("enter")
        assert source.arm.closed == closed_before + 1
        assert d.s.alarms == ()
        await d.to_step(Step.CAPTURE)
        assert d.s.drives_ready


@pytest.mark.campaign
async def test_step_change_leads_to_a_new_session(drive, source):
    async with drive(step=Step.MODES) as d:
        source.arm.off_rad[1] = 1.0
        await d.run("enter", "y")
        assert "N starts a new session" in d.hint
        first = d.runner
        await d.press("N", "y")
        await d.until(lambda: d.runner is not first, "another session")
        await d.until(lambda: d.app.step is Step.CONNECT, "its first step")


async def test_unsent_stop_names_the_hardware_stop(drive, source):
    async with drive(step=Step.CAPTURE) as d:
        source.arm.stop_error = BusError("the handle is closed")
        await d.press("space")
        await d.until(lambda: "use the hardware stop" in d.text("#banner").lower(), "alarm")


async def test_key_ends_a_motion_of_the_live_arm(drive, source):
    source.pace_s = 0.005
    async with drive(step=Step.CAPTURE) as d:
        await d.press("g")
        await d.until(lambda: source.arm.snapshot().moving, "moving")
        await d.run("z")
        assert not source.arm.stops
        assert d.s.at_waypoint is None
        assert d.s.next_waypoint == 0
        assert "ended by the operator" in d.s.messages[-1].text


@pytest.mark.campaign
async def test_calibration_can_be_cancelled(drive):
    async with drive(step=Step.CAPTURE) as d:
        await d.run("a")
        await d.press("enter", "s")
        await d.until(lambda: d.s.task is not None, "solving")
        await d.run("z")
        assert d.s.solution is None
        assert "ended by the operator" in d.s.messages[-1].text


@pytest.mark.sample(1)
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
async def test_signal_closes_session_and_arm(drive, source, number):
    async with drive(step=Step.CAPTURE) as d:
        await d.run("c")
        folder = d.s.folder
        signal.raise_signal(number)
        await d.until(lambda: d.app.return_value == number.name, "leaving")
    source.close("left")
    assert source.arm.closed == 1
    names = [e.name for e in read_journal(folder).events]
    assert names[-1] == "closed"
    assert "pose" in names


async def test_worker_exception_ends_the_app_and_closes_the_arm(drive, source):
    with pytest.raises(RuntimeError, match="worker thread failed"):  # noqa: PT012 - raised when the app ends
        async with drive(step=Step.CAPTURE) as d:
            d.app.runner.submit(TaskKind.NOTE, "breaking", lambda: 1 / 0)
            await d.until(lambda: not d.app.is_running, "ended")
    source.close("failed")
    assert source.arm.closed == 1
