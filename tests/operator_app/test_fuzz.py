"""Every parser and the wire, some odd inputs: the share of `tests/benchmarks/fuzz.py` that is run always."""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest

from tests.oracles.controller_fuzzing import ControllerTarget, NotStoppedError
from tests.oracles.fuzzing import PARSERS, outcome, over

FEWER = {"the controller's nodes": 4, "the wire": 10}
"""Each of these enables and stops an arm, or runs a session."""


@pytest.mark.parametrize("kind", PARSERS)
def test_an_input_is_accepted_or_refused_in_words(kind: str, tmp_path: Path) -> None:
    seen = {outcome(kind, seed, tmp_path) for seed in range(FEWER.get(kind, 30))}
    over()
    assert "refused" in seen


def test_a_drive_that_does_not_obey_a_stop_is_seen() -> None:
    """The judge of the controller's side: a drive that takes a quick stop for nothing does not get past it."""
    target = ControllerTarget()
    try:
        target.tell(Random(0))  # noqa: S311 - to be repeated
        peer = target.ready()
        target.drive(3).obey_controlword = lambda _controlword: None  # type: ignore[method-assign]
        with pytest.raises(NotStoppedError, match=r"joints \[3\] stay enabled"):
            target.require_stop(peer)
    finally:
        target.close()
