"""`sarcal report`: a page in the session folder, exit codes, errors."""

from pathlib import Path

import pytest

from operator_app.cli import main
from operator_app.config.poses_file import load_poses, save_poses
from operator_app.report.results.session import session_text
from operator_app.session.store.journal import Journal, read_journal
from operator_app.session.store.replay import session_state
from tests.oracles.journals import sources, write_journal, written


@pytest.fixture
def make_folder(tmp_path, reference_data):
    """A session folder with poses of the reference set, journaled as a run would."""
    poses = load_poses(reference_data / "hinge" / "hinge_quantised.csv", joint_count=7).poses

    def make(count: int = 20, immobile_joint: int | None = None) -> Path:
        q_rad, one_reading = poses.q_rad[:count].copy(), {"sd_rad": [0.0] * 7, "samples": 1}
        if immobile_joint is not None:
            q_rad[:, immobile_joint - 1] = poses.q_rad[0, immobile_joint - 1]
        events = [
            ("opened", {"sources": sources(), "settings": {"scenario": "datasheet"}}),
            ("connected", {"model": "sarcos_dextrous", "serial_number": "SDA-0009"}),
            *(
                ("pose", {**one_reading, "number": k, "waypoint": k - 1, "mean_rad": q.tolist()})
                for k, q in enumerate(q_rad, 1)
            ),
        ]
        return write_journal(tmp_path / "sessions" / "20260131-120000-hinge", written(events))

    return make


def test_page_is_written_into_the_session_folder(make_folder, run_command):
    folder = make_folder()
    assert run_command(0, "report", folder).out == f"Report      {folder / 'report.html'}\n"
    page = (folder / "report.html").read_bytes()
    assert page.startswith(b"<!DOCTYPE html>\n<html lang=")
    assert b"SDA-0009" in page
    run_command(0, "report", folder.name, "--sessions", folder.parent)
    assert (folder / "report.html").read_bytes() == page
    assert sorted(p.name for p in folder.iterdir()) == ["journal.jsonl", "report.html"]


def test_page_is_written_to_a_file_or_standard_output(make_folder, tmp_path, capfdbinary):
    folder = make_folder()
    assert main(["report", str(folder), "-o", str(tmp_path / "none" / "r.html")]) == 2
    assert b"cannot be written" in capfdbinary.readouterr().err
    target = tmp_path / "elsewhere.html"
    assert main(["report", str(folder), "-o", str(target), "--estimator", "paper"]) == 0
    assert not (folder / "report.html").exists()
    capfdbinary.readouterr()
    assert main(["report", str(folder), "-o", "-", "--estimator", "paper"]) == 0
    assert capfdbinary.readouterr().out == target.read_bytes()
    assert b"paper (chosen)" in target.read_bytes()


def test_unidentifiable_parameters_are_reported_with_exit_code_5(make_folder):
    folder = make_folder(immobile_joint=4)
    assert main(["report", str(folder)]) == 5
    page = (folder / "report.html").read_text()
    assert "Not identifiable" in page
    assert "joint 4 does not move" in page
    assert "condition number" not in page
    assert page.partition("Captured poses")[2].count("<tr") >= 20


@pytest.mark.parametrize(
    ("poses", "options"),
    [(0, []), (2, []), (4, ["--unsensed", "8"]), (4, ["--unsensed", "6", "--estimator", "paper"])],
)
def test_too_few_poses_or_invalid_option_writes_no_page(
    make_folder, poses, options, approve, run_command
):
    folder = make_folder(poses)
    answer = run_command(2, "report", folder, *options)
    assert answer.out == ""
    approve(answer.err)
    assert not (folder / "report.html").exists()


def test_poses_file_is_named_while_it_holds_the_included_poses(make_folder, run_command):
    folder = make_folder()
    file = folder / "poses.csv"

    def poses_line() -> str:
        state = session_state(read_journal(folder))
        lines = session_text(folder, state, accepted=True).splitlines()
        return next((row.removeprefix("Poses").strip() for row in lines if "Poses" in row), "")

    def append(name: str, data: dict[str, object]) -> None:
        journal = Journal.resume(folder)
        journal.append(name, data)
        journal.close()

    assert poses_line() == ""
    save_poses(file, session_state(read_journal(folder)).pose_set())
    assert poses_line() == str(file)
    append("pose_noted", {"number": 3, "text": "somebody leaned on the table"})
    assert poses_line() == str(file)
    append("pose_excluded", {"number": 4, "text": "by the operator"})
    assert poses_line() == "in the journal; poses.csv was written before they were changed"
    report = run_command(0, "report", folder, "--json").json
    assert (report["poses"], report["session"]["poses"]) == (19, None)
    file.write_text("no poses at all")
    assert poses_line().startswith("in the journal")
