"""Lost counts against everything that a joint may do otherwise, in plain numbers."""

import math
import struct
from collections.abc import Callable

import numpy as np
import pytest

from hardware.canopen.cyclic import frames_of
from hardware.control.sampling import Sampler
from hardware.monitors.joint_monitor import (
    JERK_SYNCS,
    QUIET_SYNCS,
    WINDOW_SAMPLES,
    ContinuityMonitor,
    CountJump,
)
from tests.oracles.profiles import sarcos
from tests.oracles.samples import sample

SYNCS = 200
AT = 100


def watch(
    positions: list[tuple[float, ...]],
    missing: frozenset[int] = frozenset(),
    expected: int | None = None,
) -> list[CountJump]:
    """Jumps that are seen, where some SYNCs are missed, or a jerk is expected from one on."""
    watcher = ContinuityMonitor([4.0] * len(positions[0]))
    found = []
    for sync, angles in enumerate(positions, 1):
        if sync == expected:
            watcher.expect_jerk()
        counts = [round(a) for a in angles]
        lost = (1,) if sync in missing else ()
        jump = watcher.update(sample((0,) * len(angles), counts, sync=sync, missing=lost))
        if jump is not None:
            found.append(jump)
    return found


MOTIONS: dict[str, Callable[[int], float]] = {
    "at rest": lambda _: 1234.0,
    "at one speed": lambda k: 55.3 * k,
    "swinging": lambda k: 4000.0 * math.sin(0.02 * k),
    "braking": lambda k: 100.0 * k - 0.2 * k * k,
}


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("lost", [40, -50, 500, -1111])
def test_lost_counts_are_named_with_their_size(motion, lost):
    of = MOTIONS[motion]
    positions = [
        (of(k), 0.7 * of(k), of(k) + (lost if k >= AT else 0)) for k in range(1, SYNCS + 1)
    ]
    (jump,) = watch(positions)
    assert (jump.joint, jump.sync_count) == (3, AT)
    assert jump.counts == pytest.approx(lost, abs=2)


@pytest.mark.parametrize("lost", [5, -5])
def test_at_rest_five_counts_are_enough(lost):
    positions = [(7.0, 9.0 + (lost if k >= AT else 0)) for k in range(1, SYNCS + 1)]
    assert watch(positions) == [CountJump(joint=2, counts=lost, sync_count=AT)]


@pytest.mark.parametrize("motion", MOTIONS)
def test_a_motion_alone_is_none(motion):
    of = MOTIONS[motion]
    assert watch([(of(k), -1.3 * of(k)) for k in range(1, SYNCS + 1)]) == []


def test_starting_and_stopping_short_is_none():
    """A path with the corners of a trapezoid, as moves are: 6 counts a SYNC faster every SYNC."""
    speed = [min(6.0 * max(k - 50, 0), 120.0, 6.0 * max(150 - k, 0)) for k in range(SYNCS)]
    at = np.cumsum(speed)
    assert watch([(a, 2.1 * a, 0.0) for a in at.tolist()]) == []


def test_what_jerks_the_chain_jerks_more_than_one():
    assert watch([(300.0 * (k >= AT), 45.0 * (k >= AT), 0.0) for k in range(1, SYNCS + 1)]) == []


def test_noise_is_no_slip_however_large():
    rng = np.random.default_rng(3)
    noise = rng.normal(0.0, 40.0, (SYNCS, 1)) * (np.arange(SYNCS) > 60)[:, None]
    assert watch([(0.0, float(n)) for (n,) in noise]) == []


def test_a_stop_from_full_speed_is_none():
    at = [min(k, AT) * 200.0 for k in range(1, SYNCS + 1)]
    assert watch([(a, -0.4 * a) for a in at]) == []


def test_over_a_lost_frame_nothing_is_said():
    positions = [(10.0 * k + (500 if k >= AT else 0), 0.0) for k in range(1, SYNCS + 1)]
    assert watch(positions, frozenset({AT})) == []


def test_a_drive_that_takes_its_joint_up_may_jerk_it():
    later = AT + JERK_SYNCS + WINDOW_SAMPLES
    positions = [(8.0 * (k >= AT) + 40.0 * (k >= later), 0.0) for k in range(1, SYNCS + 1)]
    # Counts that are lost after it are seen as ever.
    found = watch(positions, expected=AT - 3)
    assert [(jump.joint, jump.counts) for jump in found] == [(1, 40)]


def test_it_says_so_within_a_tenth_of_a_second():
    positions = [(0.0, 500.0 * (k >= AT)) for k in range(1, AT + QUIET_SYNCS + 1)]
    assert len(watch(positions)) == 1


def seen_through_a_sampler(
    answers: Callable[[int], tuple[tuple[int, ...], tuple[int, ...]]],
) -> bool:
    """Whether joint 1 of two is seen to jump; `answers` are its counts before and after a sample closes."""
    sampler, watcher = (
        Sampler(frames_of(sarcos(2)), max_misses=9, now_s=0.0),
        ContinuityMonitor([4.0, 4.0]),
    )
    jumped = False
    for sync in range(1, SYNCS + 1):
        sampler.open()
        in_time, late = answers(sync)
        sampler.note(0x182, struct.pack("<Hih", 0x1237, 9, 0), 0.0)
        for counts in in_time:
            sampler.note(0x181, struct.pack("<Hih", 0x1237, counts, 0), 0.0)
        sampler.close()
        for counts in late:
            sampler.note(0x181, struct.pack("<Hih", 0x1237, counts, 0), 0.0)
        if sampler.answered_late:
            watcher.restart_history()
        jumped |= watcher.update(sampler.view.sample) is not None
    return jumped


def test_a_joint_that_catches_up_with_its_answers_has_not_jumped():
    """It missed a SYNC, each answer then stood for the next, and one day two came: all samples look whole."""

    def answers(sync: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        if sync == AT - 20:
            return (), ()
        if AT - 20 < sync < AT:
            return (300 * (sync - 1),), ()
        return ((300 * (sync - 1),), (300 * sync,)) if sync == AT else ((300 * sync,), ())

    assert not seen_through_a_sampler(answers)


def test_counts_lost_between_answers_in_time_are_a_jump():
    assert seen_through_a_sampler(lambda sync: ((300 * sync + 300 * (sync >= AT),), ()))
