"""Commands run in this process, and their output."""

import json
from dataclasses import dataclass
from typing import Any

import pytest

from operator_app.cli import main


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)

    @property
    def words(self) -> str:
        """Both, with line breaks as spaces."""
        return " ".join((self.out + self.err).split())


@pytest.fixture
def run_command(capsys):
    """Run a command that ends with this exit code: ``run_command(2, "solve", file).err``."""

    def run(code: int, *words: object) -> Answer:
        capsys.readouterr()
        try:
            exit_code = main([str(word) for word in words])
        except SystemExit as usage:
            exit_code = usage.code
        output = capsys.readouterr()
        assert exit_code == code, output.err
        return Answer(out=output.out, err=output.err)

    return run
