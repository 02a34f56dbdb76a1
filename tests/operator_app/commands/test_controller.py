"""`sarcal controller` before it serves: what it cannot keep its parameters in is one error."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from operator_app.cli import main
from operator_app.errors import SessionError
from operator_app.virtual_arms import slots_in


def test_a_state_that_is_no_folder_is_one_error_that_names_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, pipe, full = tmp_path / "file", tmp_path / "pipe", tmp_path / "full"
    file.write_text("parameters")
    os.mkfifo(pipe)
    full.mkdir()
    os.mkfifo(full / "active")
    for place in (file, pipe, full, file / "below", Path("/proc/x"), Path("/proc")):
        words = ["controller", "-i", "loopback", "-c", "no-state", "--state", str(place)]
        assert main(words) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert f"parameters cannot be kept in {place} (" in said.err
        assert "leave --state out" in said.err


def test_a_folder_is_made_and_nothing_is_left_in_it(tmp_path: Path) -> None:
    slots_in(tmp_path / "a" / "b")
    assert list((tmp_path / "a" / "b").iterdir()) == []
    with pytest.raises(SessionError, match="null"):
        slots_in(Path("x\0y"))
