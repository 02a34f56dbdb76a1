"""Plain mode: numbered prompts instead of screens, on a live fake arm."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from operator_app.config.parameters_file import load_parameters
from operator_app.headless.plain import Plain
from operator_app.session.store.journal import read_journal
from operator_app.session.store.replay import session_state
from tests.oracles.live_arm import FakeSessions
from tests.oracles.script import Script, pause_briefly


def run(source: FakeSessions, *answers: str | Callable[[], str]) -> Script:
    script = Script(*answers)
    script.reason = Plain(source, script, pause=pause_briefly).run()
    return script


def press_ctrl_c() -> str:
    raise KeyboardInterrupt


TO_MODES = ("Connect", "Go on", *["Confirm:"] * 6, "Go on")
TO_CAPTURE = (*TO_MODES, "Put joints 1 and 5", "yes", "Go on")
TO_CALIBRATION = (*TO_CAPTURE, "Capture the remaining", "Go on", "Calibrate", "Go on")


def test_complete_calibration_is_uploaded_and_reported(source):
    script = run(
        source, *TO_CALIBRATION, "Read the results", "Go on", "Write", "Upload", "SDA-0001",
        "History", "Quit",
    )  # fmt: skip
    assert script.reason == "left"
    assert "SDA-0001: 1 accepted calibration" in " ".join(script.lines)
    assert any(row.startswith("ACCEPTED") for row in script.lines), script.lines[-40:]
    assert "Identified parameters" in script.lines, "the results come line by line"
    assert not any("\ufffd" in row for row in script.lines)
    ranked = [row for row in script.lines if row.startswith("Ranked ")]
    assert all(row.startswith("Ranked joints ") and ": score 0." in row for row in ranked), ranked
    assert any(row.startswith("Uploaded to slot A and read back: SHA-256 ") for row in script.lines)
    written = source.root / "session-1" / "parameters.yaml"
    assert load_parameters(written).arm.serial == "SDA-0001"
    assert source.arm.active_parameters() == written.read_bytes()
    assert any("uploaded to slot A" in row for row in script.lines)


def test_blocked_step_reports_the_reason(source):
    script = run(source, "History", "Go on to step 2")
    assert "Not done: the arm is not known: connect first (step 1)." in script.lines
    assert "Not done: no arm is connected: connect first (step 1)." in script.lines
    assert script.reason == "end of input"


@pytest.mark.campaign
def test_invalid_item_number_and_wrong_serial_number_do_nothing(source):
    script = run(
        source, lambda: "99", lambda: "one", *TO_CALIBRATION, "Go on", "Upload", "SDA-0009", "Quit"
    )
    assert sum("type a number from 1 to" in row for row in script.lines) == 2
    assert "Not done: the answer was not SDA-0001; nothing was uploaded." in script.lines
    assert source.arm.active_parameters() == b""


@pytest.mark.campaign
def test_forced_upload_needs_a_reason(source):
    limits = replace(source.procedure.acceptance, sigma_pos_mm=1e-6)
    source.procedure = replace(source.procedure, acceptance=limits)
    script = run(
        source, *TO_CALIBRATION, "Force upload", " ", "Force upload", "the demo is tonight",
        "SDA-0001", "Quit",
    )  # fmt: skip
    assert "Not done: nothing was uploaded: a reason is required." in script.lines
    written = source.root / "session-1" / "parameters.yaml"
    assert load_parameters(written).warnings[0].text.endswith("the demo is tonight")
    assert source.arm.active_parameters() == written.read_bytes()


def test_modes_are_not_set_for_too_many_joints_or_without_yes(source):
    script = run(source, *TO_MODES, "Choose other", "1 2 5", "Put joints 1 and 5", "y", "Quit")
    assert any("until a drive trips" in row for row in script.lines)
    assert "Not done: the answer was not yes." in script.lines


def test_number_of_thousands_of_digits_is_refused(source):
    """Python converts no number of more than 4300 digits."""
    digits = "1" * 5000
    script = run(
        source, lambda: digits, *TO_MODES, "Choose other", digits, "Put joints 1 and 5", "yes",
        "Go on", "Capture a pose", "Note", digits, "Quit",
    )  # fmt: skip
    assert script.reason == "left"
    assert "Not done: type joint numbers, e.g. 1 5." in script.lines
    assert f"There is no pose '{digits[:40]}'." in script.lines
    assert all(len(row) < 500 for row in script.lines)


def test_poses_are_noted_excluded_and_undone(source):
    script = run(
        source, *TO_CAPTURE, "Move to", "Capture a pose", "Capture a pose", "Note", "1",
        "cable touched?", "Exclude", "2", "Exclude", "7", "Undo", "Quit",
    )  # fmt: skip
    assert "Pose 1: noise up to" in "".join(script.lines)
    assert any("cable touched?" in row for row in script.lines)
    assert "There is no pose '7'." in script.lines
    assert any("pose 2 is undone" in row for row in script.lines)


def test_enter_stops_a_move(source):
    source.pace_s = 0.05  # a busy machine must stop the motion before its end
    script = Script(*TO_CAPTURE, "Move to", "Quit")
    # Not before the motion begins: a waiting task is cancelled with another message.
    script.key_pressed_when = lambda: source.arm.snapshot().moving
    Plain(source, script, pause=lambda _: None).run()
    assert "moving: press Enter to stop it." in script.lines
    assert any("ended by the operator" in row for row in script.lines)
    assert not source.arm.stops


def test_ctrl_c_stops_a_connected_arm_and_offers_the_reset(source):
    script = run(source, *TO_CAPTURE, press_ctrl_c, "Reset STOP", "Back to Modes", "Quit")
    assert len(source.arm.stops) == 1
    assert any("software STOP sent" in row for row in script.lines)
    assert any("STOP reset: nothing moves" in row for row in script.lines)


def test_ctrl_c_in_a_motion_waits_for_its_end_and_stops_again(source):
    """The menu comes after the task has ended, with the reset; another Ctrl-C is STOP too."""
    source.pace_s = 0.05
    script = Script(*TO_CAPTURE, "Capture the remaining", press_ctrl_c, "Reset STOP", "Quit")
    pressed: list[int] = []

    def touched() -> bool:
        if source.arm.snapshot().moving and not pressed:
            pressed.append(len(script.lines))
            raise KeyboardInterrupt
        return False

    script.key_pressed_when = touched
    assert Plain(source, script, pause=pause_briefly).run() == "left"
    assert len(source.arm.stops) == 2
    after = script.lines[pressed[0] :]
    assert not any("closed: wait" in row for row in after)
    assert any("STOP reset: nothing moves" in row for row in after)


def test_without_an_arm_nothing_is_said_to_be_held(source):
    script = run(source, "New session", "yes", "Start another", "Cancel", "Quit")
    assert script.reason == "left"
    assert not any("arm is held" in row for row in script.lines)


def test_ctrl_c_without_an_arm_ends_the_program(source):
    with pytest.raises(KeyboardInterrupt):
        run(source, press_ctrl_c)


def test_damaged_session_is_listed_with_its_remedy(source):
    damaged = source.root / "session-0"
    damaged.mkdir(parents=True)
    (damaged / "journal.jsonl").write_bytes(
        b'{"schema":"sarcal/journal/1","seq":1,"utc":"2026-01-31T12:00:00.000Z","event":"opened",'
        b'"data":{},"sum":"0123456789abcdef"}\n'
    )
    script = run(source, "Open an earlier", "2", "Quit")
    text = "\n".join(script.lines)
    assert "session-0  cannot be read:" in text
    assert "is damaged at line 1" in text
    assert f"sarcal session repair {damaged}" in text
    assert script.reason == "left"


@pytest.mark.campaign
def test_remounted_fixture_continues_the_same_session(source):
    """Both placements are captured into one pose set; in between the arm is released."""
    script = run(
        source,
        *TO_CAPTURE, "Remount the fixture",  # refused: no pose yet
        "Capture the remaining", "Remount the fixture", "yes",
        *TO_CAPTURE, "Capture the remaining", "Quit",
    )  # fmt: skip
    steps = [row[:2] for row in script.lines if row[:2].rstrip(".").isdecimal() and row[1:2] == "."]
    assert steps == ["1.", "2.", "3.", "4.", "5."], "one line each"
    assert any("±" in row for row in script.lines if row.startswith("3."))
    text = " ".join(" ".join(script.lines).split())
    assert "6 poses of this placement must still be captured" in text
    assert "Secure the arm" in text
    assert "12 of 12 poses. Placement 2." in text
    (folder,) = source.root.iterdir()
    names = [e.name for e in read_journal(folder).events]
    assert names.count("remounted") == 1
    assert names.count("connected") == 2
    # The arm is released before the remounting is journalled, and connected by the operator only.
    assert names.count("remounting") == 1
    k = names.index("remounting")
    assert names[k - 1 : k + 4] == ["closed", "remounting", "resumed", "remounted", "connected"]
    state = session_state(read_journal(folder))
    assert [p.placement for p in state.poses] == [1] * 6 + [2] * 6
    assert state.pose_set().placements == (1, 2)


@pytest.mark.campaign
def test_arm_is_connected_again_only_after_mounting_is_confirmed(source):
    """The journal keeps the fixture as unmounted until then, even if the program is killed."""
    source.simulated = False
    to_capture = ("Connect", "Confirm: the hardware stop", *TO_CAPTURE[1:])
    captured = (*to_capture, "Capture the remaining", "Remount the fixture", "yes")
    script = run(source, *captured, "Connect", "no", "Quit")
    source.close("left")
    assert any("Placement 2 has no pose yet" in row for row in script.lines)
    (folder,) = source.root.iterdir()
    events = read_journal(folder).events
    assert [e.name for e in events[-3:]] == ["remounting", "resumed", "closed"]
    assert not session_state(read_journal(folder)).mounted

    script = Script("Connect", "no", "Connect", "yes", "Quit")
    Plain(source, script, resume=folder.name, pause=lambda _: None).run()
    names = [e.name for e in read_journal(folder).events[len(events) :]]
    assert names[:3] == ["resumed", "remounted", "connected"]
