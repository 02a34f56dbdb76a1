"""Every parser and the wire, odd inputs: some always, some hundreds of each in the campaign.

An input that breaks one is made again by ``tests.oracles.fuzzing.outcome(parser, seed, folder)``; one of the wire by
all seeds up to it, for an operator that is connected has a past.
"""

import resource
import time

import pytest

from tests.oracles.fuzzing import PARSERS, outcome, over

LIMIT_S, LIMIT_MB = 5.0, 500.0
"""Of the processor, as the machine may be busy with other things, and of memory."""


@pytest.mark.parametrize("kind", PARSERS)
@pytest.mark.parametrize("times", [1, pytest.param(20, marks=pytest.mark.campaign)])
def test_an_input_is_accepted_or_refused_in_words(kind, times, tmp_path):
    seen, count, before_mb = set(), 10 if kind == "the wire" else 30, peak_mb()
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
