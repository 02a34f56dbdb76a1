"""Random input to every parser and to the bus: a few by default, hundreds of each in the campaign.

``tests.oracles.fuzzing.outcome(parser, seed, folder)`` repeats one input; of the bus, repeat all seeds up to it.
"""

import resource
import time

import pytest

from tests.oracles.fuzzing import PARSERS, outcome, over

LIMIT_S, LIMIT_MB = 5.0, 500.0
"""Processor time and memory."""


@pytest.mark.parametrize("kind", PARSERS)
@pytest.mark.parametrize("times", [1, pytest.param(20, marks=pytest.mark.campaign)])
def test_random_input_is_accepted_or_refused(kind, times, tmp_path):
    outcomes, count, before_mb = set(), 10 if kind == "the wire" else 30, peak_mb()
    for seed in range((times > 1) * count, times * count):
        begun_s = time.process_time()
        outcomes.add(outcome(kind, seed, tmp_path))
        assert time.process_time() - begun_s < LIMIT_S, seed
    over()
    assert "refused" in outcomes
    # If another test of this worker has exceeded the limit before, the peak says nothing about this one.
    assert peak_mb() < LIMIT_MB or before_mb >= LIMIT_MB


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
