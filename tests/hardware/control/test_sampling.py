"""Which joint answered which SYNC, and how one that was lost comes back."""

import struct

import pytest

from hardware.canopen.cyclic import frames_of
from hardware.control.sampling import Sampler
from tests.oracles.profiles import sarcos

PATIENCE = 3
ANSWER = struct.pack("<Hih", 0x1237, 1000, 50)


def answered(sampler: Sampler, joint: int, now_s: float) -> None:
    assert sampler.note(0x180 + joint, ANSWER, now_s)


def test_late_answer_restores_lost_joint():
    sampler = Sampler(frames_of(sarcos(2)), max_misses=PATIENCE, now_s=0.0)
    for _ in range(PATIENCE):
        sampler.open()
        sampler.close()
    assert sampler.lost() == (1, 2)

    # Nobody is waited for, so the sample is closed before anybody can answer.
    sampler.open()
    assert sampler.waiting == 0
    sampler.close()
    answered(sampler, 1, 1.0)
    assert sampler.lost() == (2,)

    sampler.open()
    assert sampler.waiting == 1
    answered(sampler, 1, 1.01)
    assert sampler.waiting == 0
    sampler.close()
    assert sampler.view.sample.missing == (2,)


def doubled(*answers: int, joints: int = 1) -> list[tuple[int, ...]]:
    """Who is seen as two at each SYNC: joint 1 answers so many times to each SYNC, the others once."""
    sampler, seen = Sampler(frames_of(sarcos(joints)), max_misses=100, now_s=0.0), []
    for count in answers:
        sampler.open()
        seen.append(sampler.duplicates())
        for joint in range(2, joints + 1):
            answered(sampler, joint, 1.0)
        for _ in range(count):
            answered(sampler, 1, 1.0)
        sampler.close()
    sampler.open()
    return [*seen, sampler.duplicates()]


@pytest.mark.parametrize(
    ("pattern", "times"),
    # On average two a SYNC, but never ten samples in a row: the second one of a joint that answers last
    # may come before or after the next SYNC.
    [((2,), 12), ((1, 3), 30), ((1, 2, 3, 2), 15)],
)
def test_second_answers_are_counted_however_they_fall_between_the_syncs(pattern, times):
    assert doubled(*pattern * times, joints=2)[-1] == (1,)


@pytest.mark.parametrize("pattern", [(1, 2, 1), (2, 2, 2, 1, 1, 1)])
def test_frames_that_come_twice_now_and_then_are_no_second_device(pattern):
    assert doubled(*pattern * 200, joints=2)[-1] == ()


def test_who_answers_once_again_is_one_device_at_once():
    assert doubled(*[2] * 100, 1)[-2:] == [(1,), ()]


@pytest.mark.parametrize(
    "answers",
    [
        pytest.param([*[0] * 30, 31, *[1] * 5] * 20, id="all at once"),
        pytest.param([*[0] * 12, *[1] * 40, 13, *[1] * 5], id="after it lagged behind for a while"),
    ],
)
def test_who_was_held_up_and_catches_up_is_one_device(answers):
    assert set(doubled(*answers)) == {()}


def test_two_that_were_held_up_are_two():
    assert doubled(*[0] * 30, 62)[-1] == (1,)
