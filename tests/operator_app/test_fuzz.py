"""Every parser and the wire, odd inputs: some always, some hundreds of each in the campaign.

An input that breaks one is made again by ``tests.oracles.fuzzing.outcome(parser, seed, folder)``; one of the wire by
all seeds up to it, for an operator that is connected has a past.
"""

from __future__ import annotations

import resource
import time
from pathlib import Path
from random import Random

import pytest

from tests.oracles.controller_fuzzing import ControllerTarget, NotStoppedError
from tests.oracles.fuzzing import PARSERS, outcome, over

FEWER = {"the controller's nodes": 4, "the wire": 10}
"""Each of these enables and stops an arm, or runs a session."""
LIMIT_S, LIMIT_MB = 5.0, 500.0
"""Of the processor, as the machine may be busy with other things, and of memory."""


@pytest.mark.parametrize("kind", PARSERS)
@pytest.mark.parametrize("times", [1, pytest.param(20, marks=pytest.mark.campaign)])
def test_an_input_is_accepted_or_refused_in_words(kind: str, times: int, tmp_path: Path) -> None:
    seen, count, before_mb = set(), FEWER.get(kind, 30), peak_mb()
    for seed in range((times > 1) * count, times * count):
        begun_s = time.process_time()
        seen.add(outcome(kind, seed, tmp_path))
        assert time.process_time() - begun_s < LIMIT_S, seed
    over()
    assert "refused" in seen
    # A worker's peak is that of all its tests: another may have passed the limit before.
    assert peak_mb() < max(LIMIT_MB, before_mb + 1.0)


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


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
