"""What a command answers that is run in this process."""

import json
from dataclasses import dataclass
from typing import Any

import pytest

from operator_app.cli import main


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What was written to the two streams."""

    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)

    @property
    def words(self) -> str:
        """All of it, however its lines are broken."""
        return " ".join((self.out + self.err).split())


@pytest.fixture
def ends_with(capsys):
    """Run a command, which must end with this exit code: ``ends_with(2, "solve", file).err``."""

    def run(code: int, *words: object) -> Answer:
        capsys.readouterr()
        try:
            ended = main([str(word) for word in words])
        except SystemExit as usage:
            ended = usage.code
        said = capsys.readouterr()
        assert ended == code, said.err
        return Answer(out=said.out, err=said.err)

    return run
