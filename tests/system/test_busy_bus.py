"""A session on a bus that others fill: SYNC keeps its time by the kernel's clock, nothing is lost, poses are right.

Ten minutes of it, and beside a busy machine: python -m tests.benchmarks.busy_bus
"""

import os

import numpy as np
import pytest

from tests.oracles.loaded_session import session_under_load


@pytest.mark.real_time
@pytest.mark.campaign
def test_eight_thousand_foreign_frames_a_second_do_not_keep_sync(tmp_path):
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
