"""Plain mode: the same way in numbered prompts, on a live fake arm."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from operator_app.config.parameters_file import load_parameters
from operator_app.headless.plain import Plain
from operator_app.session.store.journal import read_journal
from operator_app.session.store.replay import session_state
from tests.oracles.live_source import FakeSource
from tests.oracles.script import Script, look_again


def run(source: FakeSource, *answers: str | Callable[[], str]) -> Script:
    script = Script(*answers)
    script.reason = Plain(source, script, pause=look_again).run()
    return script


TO_CAPTURE = (
    "Connect", "Go on", *["Confirm:"] * 6, "Go on", "Put joints 1 and 5", "yes", "Go on",
)  # fmt: skip


def test_from_connect_to_uploaded_parameters(source):
    script = run(
        source, *TO_CAPTURE, "Capture the remaining", "Go on", "Calibrate", "Go on", "Read the results",
        "Go on", "Write", "Upload", "SDA-0001", "History", "Quit",
    )  # fmt: skip
    assert script.reason == "left"
    assert "SDA-0001: 1 accepted calibration" in " ".join(script.said)
    assert any(row.startswith("ACCEPTED") for row in script.said), script.said[-40:]
    assert "Identified parameters" in script.said, "the results come line by line"
    assert not any("\ufffd" in row for row in script.said)
    ranked = [row for row in script.said if row.startswith("Ranked ")]
    assert all(row.startswith("Ranked joints ") and ": score 0." in row for row in ranked), ranked
    assert any(row.startswith("Uploaded to slot A and read back: SHA-256 ") for row in script.said)
    written = source.root / "session-1" / "parameters.yaml"
    assert load_parameters(written).arm.serial == "SDA-0001"
    assert source.arm.active_parameters() == written.read_bytes()
    assert any("uploaded to slot A" in row for row in script.said)


def test_what_is_closed_says_why_and_is_not_done(source):
    script = run(source, "History", "Go on to step 2")
    assert "Not done: the arm is not known: connect first (step 1)." in script.said
    assert "Not done: no arm is connected: connect first (step 1)." in script.said
    assert script.reason == "end of input"


@pytest.mark.campaign
def test_a_wrong_number_and_a_wrong_serial_do_nothing(source):
    script = run(
        source, lambda: "99", lambda: "one", *TO_CAPTURE, "Capture the remaining", "Go on", "Calibrate",
        "Go on", "Go on", "Upload", "SDA-0009", "Quit",
    )  # fmt: skip
    assert sum("type a number from 1 to" in row for row in script.said) == 2
    assert "Not done: the answer was not SDA-0001; nothing was uploaded." in script.said
    assert source.arm.active_parameters() == b""


@pytest.mark.campaign
def test_what_is_not_accepted_is_uploaded_for_a_reason_only(source):
    limits = replace(source.procedure.acceptance, sigma_pos_mm=1e-6)
    source.procedure = replace(source.procedure, acceptance=limits)
    script = run(
        source, *TO_CAPTURE, "Capture the remaining", "Go on", "Calibrate", "Go on", "Force upload",
        " ", "Force upload", "the demo is tonight", "SDA-0001", "Quit",
    )  # fmt: skip
    assert "Not done: nothing was uploaded: a reason is required." in script.said
    written = source.root / "session-1" / "parameters.yaml"
    assert load_parameters(written).warnings[0].text.endswith("the demo is tonight")
    assert source.arm.active_parameters() == written.read_bytes()


def test_what_is_not_confirmed_with_yes_is_said_not_to_be_done(source):
    script = run(source, *TO_CAPTURE[:-2], "y", "Quit")
    assert "Not done: the answer was not yes." in script.said


def test_too_many_position_joints_are_refused_with_the_reason(source):
    script = run(source, *TO_CAPTURE[:-3], "Choose other", "1 2 5", "Quit")
    assert any("until a drive trips" in row for row in script.said)


def test_a_pasted_number_of_thousands_of_digits_is_refused(source):
    """Python converts none of more than 4300 digits."""
    digits = "1" * 5000
    script = run(
        source, lambda: digits, *TO_CAPTURE[:-3], "Choose other", digits, "Put joints 1 and 5", "yes", "Go on",
        "Capture a pose", "Note", digits, "Quit",
    )  # fmt: skip
    assert script.reason == "left"
    assert "Not done: type joint numbers, e.g. 1 5." in script.said
    assert f"There is no pose '{digits[:40]}'." in script.said
    assert all(len(row) < 500 for row in script.said)


def test_notes_undo_and_exclusion(source):
    script = run(
        source, *TO_CAPTURE, "Move to", "Capture a pose", "Capture a pose", "Note", "1",
        "cable touched?", "Exclude", "2", "Exclude", "7", "Undo", "Quit",
    )  # fmt: skip
    assert "Pose 1: noise up to" in "".join(script.said)
    assert any("cable touched?" in row for row in script.said)
    assert "There is no pose '7'." in script.said
    assert any("pose 2 is undone" in row for row in script.said)


def test_enter_stops_a_motion(source):
    source.pace_s = 0.05  # a busy machine must not take longer to stop than the motion takes
    script = Script(*TO_CAPTURE, "Move to", "Quit")
    # Not before it begins: a task that only waits is cancelled in other words.
    script.touches_when = lambda: source.arm.snapshot().moving
    Plain(source, script, pause=lambda _: None).run()
    assert "moving: press Enter to stop it." in script.said
    assert any("ended by the operator" in row for row in script.said)
    assert not source.arm.stops


def test_ctrl_c_is_stop_while_an_arm_is_connected_and_its_reset_is_offered(source):
    def interrupt() -> str:
        raise KeyboardInterrupt

    script = run(source, *TO_CAPTURE, interrupt, "Reset STOP", "Back to Modes", "Quit")
    assert len(source.arm.stops) == 1
    assert any("software STOP sent" in row for row in script.said)
    assert any("STOP reset: nothing moves" in row for row in script.said)


def test_ctrl_c_without_an_arm_leaves(source):
    def interrupt() -> str:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(source, interrupt)


def test_a_session_that_cannot_be_read_is_listed_and_says_what_to_do(source):
    broken = source.root / "session-0"
    broken.mkdir(parents=True)
    (broken / "journal.jsonl").write_bytes(
        b'{"schema":"sarcal/journal/1","seq":1,"utc":"2026-01-31T12:00:00.000Z","event":"opened",'
        b'"data":{},"sum":"0123456789abcdef"}\n'
    )
    script = run(source, "Open an earlier", "2", "Quit")
    said = "\n".join(script.said)
    assert "session-0  cannot be read:" in said
    assert "is damaged at line 1" in said
    assert f"sarcal session repair {broken}" in said
    assert script.reason == "left"


@pytest.mark.campaign
def test_a_fixture_mounted_anew_goes_on_in_the_same_session(source):
    """Both placements are captured into one pose set; between them the arm is let go."""
    script = run(
        source,
        *TO_CAPTURE, "Remount the fixture",  # refused: no pose yet
        "Capture the remaining", "Remount the fixture", "yes",
        *TO_CAPTURE, "Capture the remaining", "Quit",
    )  # fmt: skip
    said = " ".join(" ".join(script.said).split())
    assert "6 poses of this placement are still to be captured" in said
    assert "Secure the arm" in said
    assert "12 of 12 poses. Placement 2." in said
    (folder,) = source.root.iterdir()
    events = read_journal(folder).events
    names = [e.name for e in events]
    assert names.count("remounted") == 1
    assert names.count("connected") == 2
    # Let go before it counts, and nobody connected until the operator did.
    assert names.count("remounting") == 1
    at = names.index("remounting")
    assert names[at - 1] == "closed"
    assert names[at + 1 : at + 4] == ["resumed", "remounted", "connected"]
    state = session_state(read_journal(folder))
    assert [p.placement for p in state.poses] == [1] * 6 + [2] * 6
    assert state.pose_set().placements == (1, 2)


@pytest.mark.campaign
def test_an_arm_is_connected_again_once_somebody_says_that_its_fixture_is_mounted(source):
    """The journal says until then that it is off, whenever this program is killed."""
    source.simulated = False
    to_capture = ("Connect", "Confirm: the hardware stop", *TO_CAPTURE[1:])
    captured = (*to_capture, "Capture the remaining", "Remount the fixture", "yes")
    script = run(source, *captured, "Connect", "no", "Quit")
    source.close("left")
    assert any("Placement 2 has no pose yet" in row for row in script.said)
    (folder,) = source.root.iterdir()
    events = read_journal(folder).events
    assert [e.name for e in events[-3:]] == ["remounting", "resumed", "closed"]
    assert not session_state(read_journal(folder)).mounted

    script = Script("Connect", "no", "Connect", "yes", "Quit")
    Plain(source, script, resume=folder.name, pause=lambda _: None).run()
    names = [e.name for e in read_journal(folder).events[len(events) :]]
    assert names[:3] == ["resumed", "remounted", "connected"]
