"""What a command answers that is run in this process."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


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


EndsWith = Callable[..., Answer]
"""How a test runs a command, by the fixture `ends_with`: exit code, then the words that are typed."""
