"""A session on a bus that others fill: SYNC keeps its time by the kernel's clock, nothing is lost, poses are right.

Ten minutes of it, and beside a busy machine: python -m tests.benchmarks.busy_bus
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from tests.oracles.busy_bus import Rhythm
from tests.oracles.loaded_session import Came, session_under_load
from tests.oracles.machine_pauses import Pauses

TRIPPED = "The run ended early; the arm is held.\nsarcal: joint 1 tripped:\noperator's heartbeat lost (8130h)"


@pytest.mark.real_time
@pytest.mark.campaign
def test_eight_thousand_foreign_frames_a_second_do_not_keep_sync(tmp_path: Path) -> None:
    came = session_under_load(
        tmp_path, f"busy-test-{os.getpid()}", poses=3, samples=100, rate=8000.0, patience_s=120.0
    )
    assert came.wrong == ()
    if why := came.ended_by_the_machine():
        pytest.skip(why)
    assert came.code in (0, 4, 5), came.said
    assert came.poses == 3
    assert came.foreign / came.took_s > 4000
    # Of 8 MB: nothing piled up, so that nothing was dropped.
    assert came.backlog_bytes < 1_000_000
    # The largest one is the benchmark's to judge, on a machine that does nothing else. When a machine of
    # which there is but a share stands still, nobody on it keeps time.
    own_s = np.subtract(came.rhythm.gaps_s(), came.away_s())
    assert np.percentile(own_s, 99) < 0.050


def came(pauses: Pauses, *, code: int = 3, said: str = TRIPPED) -> Came:
    """A session of SYNCs from 100 to 110 s whose drives tripped at its end."""
    at_s = tuple(np.linspace(100.0, 110.0, 1001))
    return Came(
        code=code,
        said=said,
        poses=1,
        wrong=(),
        backlog_bytes=0,
        foreign=0,
        took_s=10.0,
        rhythm=Rhythm(at_s=at_s, answers=(7,) * len(at_s), beats_s=at_s),
        pauses=pauses,
        events=(),
    )


def test_only_a_machine_that_stood_still_at_the_end_excuses_drives_that_tripped() -> None:
    still = Pauses(of={0: [(108.9, 109.4)], 1: []})
    assert "0.50 s" in came(still).ended_by_the_machine()
    for other in (
        Pauses(of=still.of, known=False),
        Pauses(of={0: [(103.0, 103.5)], 1: []}),
        Pauses(of={0: [(109.0, 109.2)], 1: []}),
    ):
        assert came(other).ended_by_the_machine() == ""
    late = "unless drives missed the heartbeat (8130h)"
    for said in ("sarcal: joint 1 tripped: position error too large (8611h)", late):
        assert came(still, said=said).ended_by_the_machine() == ""
    assert came(still, code=0).ended_by_the_machine() == ""


def test_time_that_is_not_known_to_be_the_machines_is_taken_off_no_gap() -> None:
    gone = {0: [(108.9, 109.4)]}
    assert sum(came(Pauses(of=gone)).away_s()) == pytest.approx(0.5)
    assert not any(came(Pauses(of=gone, known=False)).away_s())
