"""The README's transcript, its figures of the paper and its examples agree with the program."""

import re
import shlex
import shutil
from itertools import groupby
from pathlib import Path

import pytest

from operator_app.cli import main

README = Path(__file__).resolve().parents[2] / "README.md"
PAPER = README.parent / "operator_app/manual/pages/paper.md"
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?!\w)")


def without_numbers(line: str) -> str:
    return " ".join(NUMBER.sub("#", line).split())


def numbers(line: str) -> list[float]:
    return [float(number) for number in NUMBER.findall(line)]


@pytest.mark.campaign
def test_transcript_agrees_with_the_output_of_run(tmp_path, run_command):
    block = README.read_text().split("```text\n")[1].split("```")[0]
    written = [line for line in block.splitlines() if line.strip()]
    out = run_command(0, "run", "hinge", "--sessions", tmp_path).out
    printed = [line for line in out.splitlines() if line.strip()]
    *parts, end = (list(lines) for gap, lines in groupby(written, "[...]".__eq__) if not gap)
    at = 0
    for part in parts:
        # The first line of a part is unique in what follows the part before.
        at += [without_numbers(line) for line in printed[at:]].index(without_numbers(part[0]))
        for expected, actual in zip(part, printed[at : at + len(part)], strict=True):
            assert without_numbers(actual) == without_numbers(expected)
            # Tolerance: other processors round differently.
            assert numbers(actual) == pytest.approx(numbers(expected), rel=0.05, abs=0.02)
        at += len(part)
    assert at > 10
    # The end has folders and lengths of one session.
    titles = [line.split()[0] for line in end]
    assert titles[0] == "Session"
    assert [line.split()[0] for line in printed[at:]][-len(titles) - 1 : -1] == titles


@pytest.mark.campaign
def test_figures_of_the_paper_agree_with_reproduce_to_the_last_digit(run_command):
    out = run_command(0, "reproduce").out
    summary = next(line for line in out.splitlines() if "all together" in line)
    pos, ori, condition = summary.split()[-3:]
    assert f"| {pos} mm, {ori} mrad, {condition} |" in README.read_text()
    page = PAPER.read_text()
    assert f"| the specimen | {pos} | {ori} | {condition} |" in page
    for title, rows in (("Share of each source", 5), ("Effect of each planned remedy", 6)):
        lines = out.split(title)[1].splitlines()[2 : 2 + rows]
        for line in lines:
            cells = re.split(r"\s{2,}", line.strip())
            assert re.search(r" \|(?: \|)? ".join(map(re.escape, cells)), page), line


@pytest.mark.campaign
def test_shell_and_python_examples_run(tmp_path, reference_data, monkeypatch, capsys):
    """On public readings of a KUKA iiwa 14 with a ball on its tool, in two sockets."""
    readings = reference_data / "real_arms"
    shutil.copy(readings / "iiwa14.urdf", tmp_path / "my_arm.urdf")
    for k in (1, 2):
        shutil.copy(readings / f"kuka_14/0{k}.csv", tmp_path / f"socket_{k}.csv")
    monkeypatch.chdir(tmp_path)
    text = README.read_text()
    (script,) = (b for b in re.findall(r"```sh\n(.*?)```", text, re.DOTALL) if "sarcal new" in b)
    for line in script.replace("\\\n", " ").splitlines():
        # The URDF's last link is the ball.
        command = shlex.split(line.replace("0,0,130", "0,0,0"), comments=True)
        assert command[0] == "sarcal"
        assert main(command[1:]) == 0, line
    assert "_calibrated.urdf" in capsys.readouterr().out
    exec(re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0], {})  # noqa: S102 - the README's
    assert "theta_off_2" in capsys.readouterr().out
    assert (tmp_path / "my_calibration" / "journal.jsonl").is_file()
