"""Events of a journal are checked: they give a state, or one error that names the line and the key."""

from collections.abc import Callable
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


def at(name: str, which: int = 0) -> int:
    return [k for k, (event, _) in enumerate(events()) if event == name][which]


def changed(name: str, **keys: Any) -> bytes:
    entries = events()
    entries[at(name)][1].update(keys)
    return written(entries)


def without(name: str, key: str) -> bytes:
    entries = events()
    del entries[at(name)][1][key]
    return written(entries)


def swapped() -> bytes:
    entries = events()
    first, second = at("pose", 0), at("pose", 1)
    entries[first], entries[second] = entries[second], entries[first]
    return written(entries)


WRONG: dict[str, tuple[Callable[[], bytes], str]] = {
    "sources missing": (lambda: without("opened", "sources"), "opened.sources"),
    "sources a list": (lambda: changed("opened", sources=[]), "opened.sources"),
    "source a number": (lambda: changed("opened", sources={"arm": 3}), "opened.sources"),
    "settings missing": (lambda: without("resumed", "settings"), "resumed.settings"),
    "poses text": (lambda: changed("opened", settings={"poses": "x"}), "settings"),
    "poses true": (lambda: changed("opened", settings={"poses": True}), "settings"),
    "plan": (lambda: changed("opened", settings={"plan": "later"}), "settings"),
    "scenario": (lambda: changed("opened", settings={"scenario": "q"}), "settings"),
    "seed": (lambda: changed("opened", settings={"seed": -1}), "settings"),
    "serial a number": (lambda: changed("connected", serial_number=5), "serial_number"),
    "nodes": (lambda: changed("connected", nodes=[5]), "connected.nodes"),
    "node": (lambda: changed("connected", nodes=[{"node": 1}]), "nodes"),
    "start of 6": (lambda: changed("modes", modes=["free"] * 6), "modes.modes"),
    "mode": (lambda: changed("modes", modes=["up"] * 7), "modes.modes"),
    "mean missing": (lambda: without("pose", "mean_rad"), "pose.mean_rad"),
    "mean of 6": (lambda: changed("pose", mean_rad=Q[:6]), "pose.mean_rad"),
    "mean of text": (lambda: changed("pose", mean_rad=["a"] * 7), "mean_rad"),
    "mean nested": (lambda: changed("pose", mean_rad=[Q] * 7), "mean_rad"),
    "mean null": (lambda: changed("pose", mean_rad=None), "mean_rad"),
    "counts": (lambda: changed("pose", mean_rad=[4e5] * 7), "pose.mean_rad"),
    "negative spread": (lambda: changed("pose", sd_rad=[-0.1] * 7), "pose.sd_rad"),
    "no samples": (lambda: changed("pose", samples=0), "pose.samples"),
    "many samples": (lambda: changed("pose", samples=10**30), "pose.samples"),
    "half a sample": (lambda: changed("pose", samples=1.5), "pose.samples"),
    "note a list": (lambda: changed("pose", note=[]), "pose.note"),
    "number negative": (lambda: changed("pose", number=-1), "pose.number"),
    "pose twice": (swapped, "pose.number"),
    "exclusion": (lambda: without("pose_excluded", "text"), "pose_excluded.text"),
    "drives": (lambda: changed("drives_chosen", drives=[1, 9]), "drives"),
    "sets": (lambda: changed("drives_chosen", sets=3), "drives_chosen.sets"),
    "requested": (lambda: changed("campaign", requested=[]), "campaign.requested"),
    "targets": (lambda: changed("campaign_move", targets_rad={"x": 1}), "targets_rad"),
    "end": (lambda: changed("campaign_ended", weak=[{}]), "campaign_ended.weak"),
    "accepted": (lambda: changed("solved", accepted="yes"), "solved.accepted"),
    "record": (lambda: changed("solved", record=[]), "solved.record"),
    "upload": (lambda: changed("exported", uploaded={}), "exported.uploaded"),
    "verified with": (lambda: changed("verified", poses="x"), "verified.poses"),
    "verified to": (lambda: changed("verified", position_m=[]), "verified.position_m"),
    "verdict": (lambda: changed("verified", holds="no"), "verified.holds"),
}


@pytest.mark.parametrize("kind", WRONG)
def test_invalid_event_data_is_one_error_with_file_line_and_key(
    tmp_path, kind, run_command, approve
):
    make, key = WRONG[kind]
    folder = write_journal(tmp_path / "sessions" / "one", make())
    path = folder / JOURNAL_NAME
    contents = read_journal(folder)
    with pytest.raises(JournalDamagedError, match=r"line \d+: ") as refused:
        session_state(contents)
    assert key in refused.value.problem
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
