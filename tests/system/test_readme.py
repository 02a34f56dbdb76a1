"""What the README prints, its figures of the paper's experiment and its ways in are those of today's program."""

import re
import shlex
import shutil
from itertools import groupby
from pathlib import Path

import pytest

from operator_app.cli import main

README = Path(__file__).resolve().parents[2] / "README.md"
PAPER = README.parent / "operator_app/manual/pages/paper.md"
LEFT_OUT = "[...]"
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?!\w)")


def words(line: str) -> str:
    return " ".join(NUMBER.sub("#", line).split())


@pytest.mark.campaign
def test_the_transcript_is_true(tmp_path, ends_with):
    block = README.read_text().split("```text\n")[1].split("```")[0]
    written = [line for line in block.splitlines() if line.strip()]
    said = ends_with(0, "run", "hinge", "--sessions", tmp_path).out
    printed = [line for line in said.splitlines() if line.strip()]
    *parts, end = (list(g) for gap, g in groupby(written, LEFT_OUT.__eq__) if not gap)
    at = 0
    for part in parts:
        # A part begins with a line that is its own, after the part before.
        at += [words(line) for line in printed[at:]].index(words(part[0]))
        for before, now in zip(part, printed[at : at + len(part)], strict=True):
            assert words(now) == words(before)
            # Another processor may round the last digits differently; nobody else's arm looks like this.
            assert [float(n) for n in NUMBER.findall(now)] == pytest.approx(
                [float(n) for n in NUMBER.findall(before)], rel=0.05, abs=0.02
            )
        at += len(part)
    assert at > 10
    # Folders and lengths at the end are of that session alone.
    names = [line.split()[0] for line in end]
    assert names[0] == "Session"
    assert [line.split()[0] for line in printed[at:]][-len(names) - 1 : -1] == names


@pytest.mark.campaign
def test_figures_of_the_paper_are_what_reproduce_prints(ends_with):
    """To the last digit, in README and manual."""
    found = ends_with(0, "reproduce").out
    together = next(line for line in found.splitlines() if "all together" in line)
    pos, ori, condition = together.split()[-3:]
    assert f"| {pos} mm, {ori} mrad, {condition} |" in README.read_text()
    page = PAPER.read_text()
    assert f"| the specimen | {pos} | {ori} | {condition} |" in page
    for title, rows in (("Share of each source", 5), ("Effect of each planned remedy", 6)):
        lines = found.split(title)[1].splitlines()[2 : 2 + rows]
        for line in lines:
            cells = re.split(r"\s{2,}", line.strip())
            assert re.search(r" \|(?: \|)? ".join(map(re.escape, cells)), page), line


@pytest.mark.campaign
def test_its_script_and_its_python_run(tmp_path, reference_data, monkeypatch, capsys):
    """On the public readings of a KUKA iiwa 14, whose tool holds a ball in two sockets."""
    real = reference_data / "real_arms"
    shutil.copy(real / "iiwa14.urdf", tmp_path / "my_arm.urdf")
    for k in (1, 2):
        shutil.copy(real / f"kuka_14/0{k}.csv", tmp_path / f"socket_{k}.csv")
    monkeypatch.chdir(tmp_path)
    text = README.read_text()
    (script,) = (b for b in re.findall(r"```sh\n(.*?)```", text, re.DOTALL) if "sarcal new" in b)
    for line in script.replace("\\\n", " ").splitlines():
        # The URDF's last link is the ball.
        words = shlex.split(line.replace("0,0,130", "0,0,0"), comments=True)
        assert words[0] == "sarcal"
        assert main(words[1:]) == 0, line
    assert "_calibrated.urdf" in capsys.readouterr().out
    exec(re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0], {})  # noqa: S102 - the README's
    assert "theta_off_2" in capsys.readouterr().out
    assert (tmp_path / "my_calibration" / "journal.jsonl").is_file()
