"""Which joint answered which SYNC, and how one that was lost comes back."""

from __future__ import annotations

from hardware.cyclic import TPDO1
from hardware.sampling import Sampler

PATIENCE = 3
ANSWER = TPDO1.pack(0x1237, 1000, 50)


def answered(sampler: Sampler, joint: int, now_s: float) -> None:
    sampler.note(joint, ANSWER, now_s)


def test_a_lost_joint_comes_back_with_an_answer_after_its_sample_was_closed() -> None:
    sampler = Sampler(2, patience=PATIENCE, now_s=0.0)
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
