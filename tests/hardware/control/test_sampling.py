"""Which joint answered which SYNC, and how one that was lost comes back."""

import struct

from hardware.canopen.cyclic import frames_of
from hardware.control.sampling import Sampler
from tests.oracles.profiles import sarcos

PATIENCE = 3
ANSWER = struct.pack("<Hih", 0x1237, 1000, 50)


def answered(sampler: Sampler, joint: int, now_s: float) -> None:
    assert sampler.note(0x180 + joint, ANSWER, now_s)


def test_a_lost_joint_comes_back_with_an_answer_after_its_sample_was_closed() -> None:
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


def doubled_after(pattern: tuple[int, ...], syncs: int) -> tuple[int, ...]:
    """Who is seen as two when joint 1 answers so many times between one SYNC and the next, in turn."""
    sampler = Sampler(frames_of(sarcos(2)), max_misses=PATIENCE, now_s=0.0)
    for sync in range(syncs):
        sampler.open()
        answered(sampler, 2, float(sync))
        for _ in range(pattern[sync % len(pattern)]):
            answered(sampler, 1, float(sync))
        sampler.close()
    sampler.open()
    return sampler.duplicates()


def test_second_answers_are_counted_however_they_fall_between_the_syncs() -> None:
    # On average two a SYNC, but never ten samples in a row: the second one of a joint that answers last
    # may come before or after the next SYNC.
    assert doubled_after((2,), 12) == (1,)
    assert doubled_after((1, 3), 60) == (1,)
    assert doubled_after((1, 2, 3, 2), 60) == (1,)


def test_frames_that_come_twice_now_and_then_are_no_second_device() -> None:
    assert doubled_after((1, 2, 1), 600) == ()
    assert doubled_after((2, 2, 2, 1, 1, 1), 600) == ()


def test_who_answers_once_again_is_one_device_at_once() -> None:
    sampler = Sampler(frames_of(sarcos(1)), max_misses=PATIENCE, now_s=0.0)
    for _ in range(100):
        sampler.open()
        answered(sampler, 1, 0.0)
        answered(sampler, 1, 0.0)
        sampler.close()
    sampler.open()
    answered(sampler, 1, 0.0)
    assert sampler.duplicates() == (1,)
    sampler.close()
    sampler.open()
    assert sampler.duplicates() == ()


def test_who_was_held_up_and_answers_all_at_once_is_one_device() -> None:
    sampler = Sampler(frames_of(sarcos(1)), max_misses=100, now_s=0.0)
    for _ in range(20):
        for _ in range(30):  # nothing comes for 30 SYNCs
            sampler.open()
            sampler.close()
        for _ in range(31):
            answered(sampler, 1, 1.0)
        for _ in range(5):
            sampler.open()
            answered(sampler, 1, 1.0)
            sampler.close()
        assert sampler.duplicates() == ()


def test_two_that_were_held_up_are_two() -> None:
    sampler = Sampler(frames_of(sarcos(1)), max_misses=100, now_s=0.0)
    for _ in range(30):
        sampler.open()
        sampler.close()
    for _ in range(62):
        answered(sampler, 1, 1.0)
    sampler.open()
    assert sampler.duplicates() == (1,)


def test_who_lags_behind_for_a_while_before_he_catches_up_is_one_device() -> None:
    sampler = Sampler(frames_of(sarcos(1)), max_misses=100, now_s=0.0)
    for answers in [*[0] * 12, *[1] * 40, 13, *[1] * 5]:
        sampler.open()
        for _ in range(answers):
            answered(sampler, 1, 1.0)
        sampler.close()
        assert sampler.duplicates() == ()
