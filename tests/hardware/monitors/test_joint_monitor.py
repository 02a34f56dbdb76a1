import math
import struct
from collections.abc import Callable

import numpy as np
import pytest

from hardware.arm import JointMode
from hardware.arm_description import JointScale
from hardware.canopen.cyclic import Setpoint, frames_of
from hardware.control.alarms import stop_error
from hardware.control.sampling import Sampler
from hardware.monitors import joint_monitor
from hardware.monitors.following import DIVERGED_SYNCS
from tests.oracles.profiles import sarcos
from tests.oracles.samples import sample

SYNCS = 200
AT = 100
"""SYNC of the jump."""


def watch(
    positions: Callable[[int], tuple[float, ...]],
    *,
    syncs: int = SYNCS,
    missing: int | None = None,
    jerk_expected: int | None = None,
) -> list[joint_monitor.CountJump]:
    """Return the jumps detected; joint 1 misses one SYNC, and a jerk may be expected from one SYNC on."""
    monitor = joint_monitor.ContinuityMonitor([4.0] * len(positions(0)))
    jumps = []
    for sync in range(1, syncs + 1):
        if sync == jerk_expected:
            monitor.expect_jerk()
        counts = [round(angle) for angle in positions(sync)]
        lost = (1,) if sync == missing else ()
        status = (0x4000 * (sync % 2),) * len(counts)  # the maker's bit 14 toggles
        jumps.append(monitor.update(sample(status, counts, sync=sync, missing=lost)))
    return [jump for jump in jumps if jump is not None]


def test_divergence_is_stated_in_degrees_of_the_joint():
    """A drive may count backwards."""
    monitor = joint_monitor.JointMonitor([4.0])
    monitor.set_following_windows([10.0], [JointScale(counts_per_rad=-100.0)])
    for sync in range(DIVERGED_SYNCS):
        answer = sample((0x1627,), (-50,), sync=sync)
        monitor.update(answer, (Setpoint(0x0F, 0, JointMode.POSITION),), answered_late=False)
    text = str(stop_error(monitor.divergence))
    assert "is -50 counts from its target (+28.6 deg)" in text


MOTIONS: dict[str, Callable[[int], float]] = {
    "at rest": lambda _: 1234.0,
    "constant speed": lambda k: 55.3 * k,
    "oscillating": lambda k: 4000.0 * math.sin(0.02 * k),
    "braking": lambda k: 100.0 * k - 0.2 * k * k,
}


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
@pytest.mark.parametrize("counts", [40, -50, 500, -1111])
def test_jump_is_reported_with_joint_size_and_sync(motion, counts):
    (jump,) = watch(lambda k: (motion(k), 0.7 * motion(k), motion(k) + counts * (k >= AT)))
    assert (jump.joint, jump.sync_count) == (3, AT)
    assert jump.counts == pytest.approx(counts, abs=2)


@pytest.mark.parametrize("counts", [5, -5])
def test_jump_of_five_counts_at_rest_is_reported(counts):
    (jump,) = watch(lambda k: (7.0, 9.0 + counts * (k >= AT)))
    assert jump == joint_monitor.CountJump(joint=2, counts=counts, sync_count=AT)


def trapezoid(k: int) -> float:
    """Position with the corners of a short move: 6 counts per SYNC faster every SYNC."""
    return sum(min(6.0 * max(n - 50, 0), 120.0, 6.0 * max(150 - n, 0)) for n in range(k + 1))


NOISE = np.random.default_rng(3).normal(0.0, 40.0, SYNCS + 1) * (np.arange(SYNCS + 1) > 60)


@pytest.mark.parametrize(
    "positions",
    [
        *(lambda k, of=of: (of(k), -1.3 * of(k)) for of in MOTIONS.values()),
        lambda k: (trapezoid(k), 2.1 * trapezoid(k), 0.0),
        lambda k: (300.0 * (k >= AT), 45.0 * (k >= AT), 0.0),
        lambda k: (0.0, float(NOISE[k])),
        lambda k: (200.0 * min(k, AT), -80.0 * min(k, AT)),
    ],
    ids=[*MOTIONS, "trapezoid", "jerk of two joints", "noise", "stop from full speed"],
)
def test_motion_noise_and_jerks_of_several_joints_are_no_jump(positions):
    assert watch(positions) == []


def test_jump_during_a_missing_answer_is_not_reported():
    assert watch(lambda k: (10.0 * k + 500 * (k >= AT), 0.0), missing=AT) == []


def test_expected_jerk_is_not_reported_and_a_later_jump_is():
    later = AT + joint_monitor.JERK_SYNCS + joint_monitor.WINDOW_SAMPLES
    (jump,) = watch(lambda k: (8.0 * (k >= AT) + 40.0 * (k >= later), 0.0), jerk_expected=AT - 3)
    assert (jump.joint, jump.counts) == (1, 40)


def test_jump_is_reported_within_quiet_syncs():
    syncs = AT + joint_monitor.QUIET_SYNCS
    assert len(watch(lambda k: (0.0, 500.0 * (k >= AT)), syncs=syncs)) == 1


def jump_is_detected_in_answers(
    answers: Callable[[int], tuple[tuple[int, ...], tuple[int, ...]]],
) -> bool:
    """Sample joint 1 of two; `answers`: its counts received before and after the sample of a SYNC closes."""
    sampler = Sampler(frames_of(sarcos(2)), max_misses=9, now_s=0.0)
    monitor = joint_monitor.ContinuityMonitor([4.0, 4.0])
    detected = False
    for sync in range(1, SYNCS + 1):
        sampler.open()
        in_time, late = answers(sync)
        sampler.note(0x182, struct.pack("<Hih", 0x1237, 9, 0), 0.0)
        for counts in in_time:
            sampler.note(0x181, struct.pack("<Hih", 0x1237, counts, 0), 0.0)
        sampler.close()
        for counts in late:
            sampler.note(0x181, struct.pack("<Hih", 0x1237, counts, 0), 0.0)
        behind = sampler.answered_late
        detected |= monitor.update(sampler.view.sample, answered_late=behind) is not None
    return detected


def test_late_answers_that_catch_up_are_no_jump():
    """After a missed SYNC each answer is one SYNC late, until two arrive at once: all samples are complete."""

    def answers(sync: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        if sync == AT - 20:
            return (), ()
        if AT - 20 < sync < AT:
            return (300 * (sync - 1),), ()
        return ((300 * (sync - 1),), (300 * sync,)) if sync == AT else ((300 * sync,), ())

    assert not jump_is_detected_in_answers(answers)


def test_counts_lost_between_answers_in_time_are_a_jump():
    assert jump_is_detected_in_answers(lambda sync: ((300 * sync + 300 * (sync >= AT),), ()))
