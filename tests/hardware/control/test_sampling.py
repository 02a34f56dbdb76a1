"""Which joint answered which SYNC: lost joints, and two devices with one node number."""

import struct

import pytest

from hardware.canopen.cyclic import frames_of
from hardware.control.sampling import Sampler
from tests.oracles.profiles import sarcos

MAX_MISSES = 3
ANSWER = struct.pack("<Hih", 0x1237, 1000, 50)


def answer(sampler: Sampler, joint: int, now_s: float) -> None:
    assert sampler.note(0x180 + joint, ANSWER, now_s)


def test_late_answer_restores_lost_joint():
    sampler = Sampler(frames_of(sarcos(2)), max_misses=MAX_MISSES, now_s=0.0)
    for _ in range(MAX_MISSES):
        sampler.open()
        sampler.close()
    assert sampler.lost() == (1, 2)

    # No joint is awaited, so the sample is closed before any can answer.
    sampler.open()
    assert sampler.waiting == 0
    sampler.close()
    answer(sampler, 1, 1.0)
    assert sampler.lost() == (2,)

    sampler.open()
    assert sampler.waiting == 1
    answer(sampler, 1, 1.01)
    assert sampler.waiting == 0
    sampler.close()
    assert sampler.view.sample.missing == (2,)


def duplicates(*answers: int, joints: int) -> list[tuple[int, ...]]:
    """Return the reported duplicates at each SYNC if joint 1 answers so many times per SYNC, the others once."""
    sampler, reported = Sampler(frames_of(sarcos(joints)), max_misses=100, now_s=0.0), []
    for count in answers:
        sampler.open()
        reported.append(sampler.duplicates())
        for joint in range(2, joints + 1):
            answer(sampler, joint, 1.0)
        for _ in range(count):
            answer(sampler, 1, 1.0)
        sampler.close()
    sampler.open()
    return [*reported, sampler.duplicates()]


@pytest.mark.parametrize(
    ("answers", "joints", "last_reports"),
    [
        # Two answers per SYNC on average, but never in ten samples in a row: the second answer of a joint
        # that answers last may come before or after the next SYNC.
        pytest.param([2] * 12, 2, [(1,)], id="twice"),
        pytest.param([1, 3] * 30, 2, [(1,)], id="once and three times"),
        pytest.param([1, 2, 3, 2] * 15, 2, [(1,)], id="two on average"),
        pytest.param([1, 2, 1] * 200, 2, [()], id="twice in three"),
        pytest.param([1, 2] * 50, 2, [(1,), (1,)], id="twice half of the time"),
        pytest.param([*[2] * 100, 1, 1], 1, [(1,), ()], id="then once"),
        pytest.param([*[0] * 30, 62], 1, [(1,)], id="those of two devices after a lag"),
        pytest.param([*[0] * 30, 31, *[1] * 5] * 20, 1, [()] * 721, id="all at once"),
        pytest.param([*[0] * 12, *[1] * 40, 13, *[1] * 5], 1, [()] * 59, id="after a lag"),
    ],
)
def test_persistent_second_answers_report_duplicate_node(answers, joints, last_reports):
    assert duplicates(*answers, joints=joints)[-len(last_reports) :] == last_reports


def test_sample_states_the_answers_that_joints_still_owe():
    """Joint 1 falls three SYNCs behind, then catches up with all of them at once."""
    sampler, owed = Sampler(frames_of(sarcos(2)), max_misses=100, now_s=0.0), []
    for count in (1, 0, 0, 0, 1, 1, 4, 1):
        sampler.open()
        answer(sampler, 2, 1.0)
        for _ in range(count):
            answer(sampler, 1, 1.0)
        sampler.close()
        one, other = sampler.view.sample.overdue
        owed.append(one - other)
    assert owed == [0, 0, 1, 2, 3, 3, 3, 0]
