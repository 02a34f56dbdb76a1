"""Events of a journal are checked: they give a state, or one error that names the line and the key."""

from typing import Any

import pytest

from operator_app.errors import JournalDamagedError
from operator_app.session.store.folders import list_sessions, read_session
from operator_app.session.store.journal import JOURNAL_NAME, read_journal
from operator_app.session.store.replay import session_state
from operator_app.session.store.state import SessionState
from operator_app.session.workflow.opening import Choices, resume
from tests.oracles.journals import events, write_journal, written

Q = [0.1] * 7
MISSING = object()
# By the kind of mistake: event, key and wrong value, place in the problem.
WRONG: dict[str, tuple[str, str, Any, str]] = {
    "sources missing": ("opened", "sources", MISSING, "opened.sources"),
    "sources a list": ("opened", "sources", [], "opened.sources"),
    "source a number": ("opened", "sources", {"arm": 3}, "opened.sources"),
    "settings missing": ("resumed", "settings", MISSING, "resumed.settings"),
    "poses text": ("opened", "settings", {"poses": "x"}, "settings"),
    "poses true": ("opened", "settings", {"poses": True}, "settings"),
    "plan": ("opened", "settings", {"plan": "later"}, "settings"),
    "scenario": ("opened", "settings", {"scenario": "q"}, "settings"),
    "seed": ("opened", "settings", {"seed": -1}, "settings"),
    "serial a number": ("connected", "serial_number", 5, "serial_number"),
    "nodes": ("connected", "nodes", [5], "connected.nodes"),
    "node": ("connected", "nodes", [{"node": 1}], "nodes"),
    "start of 6": ("modes", "modes", ["free"] * 6, "modes.modes"),
    "mode": ("modes", "modes", ["up"] * 7, "modes.modes"),
    "mean missing": ("pose", "mean_rad", MISSING, "pose.mean_rad"),
    "mean of 6": ("pose", "mean_rad", Q[:6], "pose.mean_rad"),
    "mean of text": ("pose", "mean_rad", ["a"] * 7, "mean_rad"),
    "mean nested": ("pose", "mean_rad", [Q] * 7, "mean_rad"),
    "mean null": ("pose", "mean_rad", None, "mean_rad"),
    "counts": ("pose", "mean_rad", [4e5] * 7, "pose.mean_rad"),
    "negative spread": ("pose", "sd_rad", [-0.1] * 7, "pose.sd_rad"),
    "no samples": ("pose", "samples", 0, "pose.samples"),
    "many samples": ("pose", "samples", 10**30, "pose.samples"),
    "half a sample": ("pose", "samples", 1.5, "pose.samples"),
    "note a list": ("pose", "note", [], "pose.note"),
    "number negative": ("pose", "number", -1, "pose.number"),
    "pose twice": ("pose", "number", 2, "pose.number"),
    "pose out of order": ("pose", "number", 3, "pose.number"),
    "exclusion": ("pose_excluded", "text", MISSING, "pose_excluded.text"),
    "drives": ("drives_chosen", "drives", [1, 9], "drives"),
    "sets": ("drives_chosen", "sets", 3, "drives_chosen.sets"),
    "requested": ("campaign", "requested", [], "campaign.requested"),
    "targets": ("campaign_move", "targets_rad", {"x": 1}, "targets_rad"),
    "end": ("campaign_ended", "weak", [{}], "campaign_ended.weak"),
    "accepted": ("solved", "accepted", "yes", "solved.accepted"),
    "record": ("solved", "record", [], "solved.record"),
    "upload": ("exported", "uploaded", {}, "exported.uploaded"),
    "verified with": ("verified", "poses", "x", "verified.poses"),
    "verified to": ("verified", "position_m", [], "verified.position_m"),
    "verdict": ("verified", "holds", "no", "verified.holds"),
}


@pytest.mark.parametrize("kind", WRONG)
def test_invalid_event_data_is_one_error_with_file_line_and_key(
    tmp_path, kind, run_command, approve
):
    event, key, value, place = WRONG[kind]
    entries = events()
    data = next(data for name, data in entries if name == event)
    data[key] = value
    if value is MISSING:
        del data[key]
    folder = write_journal(tmp_path / "sessions" / "one", written(entries))
    path = folder / JOURNAL_NAME
    contents = read_journal(folder)
    with pytest.raises(JournalDamagedError, match=r"line \d+: ") as refused:
        session_state(contents)
    assert place in refused.value.problem
    approve(refused.value.problem)
    assert refused.value.path == path
    assert contents.events[refused.value.line - 1].name in refused.value.problem
    root = ["--sessions", str(folder.parent)]
    for command in (["report", "one"], ["export", "one"], ["run", "--resume", "one"]):
        message = run_command(2, *command, *root).err
        assert message.startswith(f"sarcal: {path} is damaged at line {refused.value.line}")
        assert "sarcal session repair" in message
    row = run_command(0, "session", "list", *root).out.splitlines()[-1]
    assert "  journal.jsonl is damaged at line" in row
    assert row.count(str(folder)) == 1


def test_poses_of_another_joint_count_are_refused(tmp_path):
    shorter = [
        (name, {k: v[:5] if isinstance(v, list) and len(v) == 7 else v for k, v in data.items()})
        for name, data in events()
    ]
    write_journal(tmp_path, written(shorter))
    assert read_session(tmp_path).problem == ""
    with pytest.raises(JournalDamagedError, match=r"line 4: control.start_rad: has 5 items"):
        resume(str(tmp_path), Choices(), root=tmp_path)


def test_an_unreadable_session_does_not_hide_others(tmp_path, run_command):
    for name, raw in (("a", written(events())), ("b", b"Dear diary\n"), ("c", b"")):
        write_journal(tmp_path / name, raw)
    (tmp_path / "d" / JOURNAL_NAME).mkdir(parents=True)
    entries = {entry.folder.name: entry for entry in list_sessions(tmp_path)}
    assert entries["a"].problem == ""
    assert [p.number for p in entries["a"].state.used_poses] == [1, 2, 4]
    assert "another program's file" in entries["b"].problem
    assert "is empty" in entries["c"].problem
    assert "a folder" in entries["d"].problem
    root = ["--sessions", str(tmp_path)]
    run_command(0, "session", "list", *root)
    assert str(tmp_path / "a") in run_command(0, "session", "show", "latest", *root).out


def test_event_without_any_one_key_gives_a_state_or_one_error(tmp_path):
    for k, (_, data) in enumerate(events()):
        for key in data:
            entries = events()
            del entries[k][1][key]
            entry = read_session(write_journal(tmp_path, written(entries)))
            assert isinstance(entry.state, SessionState) or entry.problem, key
