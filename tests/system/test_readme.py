"""The README's transcript is what the program prints today."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from operator_app.cli import main

README = Path(__file__).resolve().parents[2] / "README.md"
LEFT_OUT = "[...]"
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?!\w)")


def words(line: str) -> str:
    return " ".join(NUMBER.sub("#", line).split())


@pytest.mark.campaign
def test_the_transcript_is_true(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    block = README.read_text().split("```text\n")[1].split("```")[0]
    written = [line for line in block.splitlines() if line.strip()]
    assert main(["run", "hinge", "--sessions", str(tmp_path)]) == 0
    said = capsys.readouterr()
    # Where stderr is no terminal every pose has a line of its own.
    pose = re.compile(r"Pose \d+ captured")
    lines = (said.err + said.out).splitlines()
    printed = [line for line in lines if line.strip() and not pose.match(line)]
    # Its middle is left out of the README.
    gap = written.index(LEFT_OUT)
    printed = [*printed[:gap], LEFT_OUT, *printed[len(printed) - len(written) + gap + 1 :]]
    # Folders, lengths and digests at the end are of that session alone.
    end = next(k for k, line in enumerate(written) if line.startswith("Session"))
    assert [line.split()[0] for line in printed[end:]] == [
        line.split()[0] for line in written[end:]
    ]
    for before, now in zip(written[:end], printed[:end], strict=True):
        assert words(now) == words(before)
        numbers = [float(n) for n in NUMBER.findall(now)]
        # Another processor may round the last digits differently; nobody else's arm looks like this.
        assert numbers == pytest.approx(
            [float(n) for n in NUMBER.findall(before)], rel=0.05, abs=0.02
        )
