"""Every parser and the wire, some odd inputs: the share of `tests/benchmarks/fuzz.py` that is run always."""

from __future__ import annotations

from pathlib import Path

import pytest

from oracles.fuzzing import PARSERS, outcome, over


@pytest.mark.parametrize("kind", PARSERS)
def test_an_input_is_accepted_or_refused_in_words(kind: str, tmp_path: Path) -> None:
    seen = {outcome(kind, seed, tmp_path) for seed in range(30)}
    over()
    assert "refused" in seen
