"""A session on a bus with foreign traffic: SYNC keeps its period, no frame is lost, poses are right.

Ten minutes of it, and beside a busy machine: python -m tests.benchmarks.busy_bus
"""

import os

import numpy as np
import pytest

from tests.oracles.loaded_session import run_session_under_load


@pytest.mark.real_time
@pytest.mark.campaign
def test_sync_keeps_its_period_under_8000_foreign_frames_per_second(tmp_path):
    outcome = run_session_under_load(
        tmp_path, f"busy-test-{os.getpid()}", poses=3, samples=100, rate=8000.0, patience_s=120.0
    )
    assert outcome.wrong == ()
    if outcome.tripped_by_pause_s:
        pytest.skip(
            f"the machine paused for {outcome.tripped_by_pause_s:.2f} s: the drives tripped"
        )
    assert outcome.code in (0, 4, 5), outcome.output
    assert outcome.poses == 3
    assert outcome.foreign_per_s > 4000
    assert outcome.backlog_bytes < 1_000_000  # the kernel drops frames from 8 MB on
    # The largest gap is judged by the benchmark, on an idle machine; pauses of the machine itself do not count.
    assert np.percentile(outcome.own_gaps_s, 99) < 0.050
