"""Pose sets: validation, read-only arrays, digest, parts held out."""

from typing import Any

import numpy as np
import pytest

from solver.chain.poses import PoseSet
from solver.diagnostics.cross_validation import far_block, fold_poses


def pose_set(**changes: Any) -> PoseSet:
    values: dict[str, Any] = {
        "placement": np.array([1, 1, 2]),
        "label": ("1", "2", "1"),
        "q_rad": np.arange(6.0).reshape(3, 2),
        "sd_rad": np.full((3, 2), 1e-4),
        "samples": np.array([32, 32, 16]),
        "endpoint": np.arange(9.0).reshape(3, 3),
        "utc": ("", "", "2026-01-31T12:00:00Z"),
        "notes": ("a", "", ""),
    }
    return PoseSet(**(values | changes))


def test_arrays_are_copies_and_read_only():
    q = np.zeros((3, 2))
    p = pose_set(q_rad=q)
    q[0, 0] = 7.0
    assert p.q_rad[0, 0] == 0.0
    for array in (p.q_rad, p.sd_rad, p.samples, p.endpoint, p.placement):
        assert array is not None
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


@pytest.mark.parametrize(
    "change",
    [
        {"q_rad": np.zeros(3)},
        {"q_rad": np.zeros((3, 0))},
        {"q_rad": np.zeros((4, 2))},
        {"q_rad": np.full((3, 2), np.nan)},
        {"sd_rad": np.zeros((3, 1))},
        {"sd_rad": np.full((3, 2), -1.0)},
        {"samples": np.array([1, 0, 1])},
        {"samples": np.array([1.0, 2.0, 3.0])},
        {"samples": np.ones((3, 1), dtype=int)},
        {"placement": np.array([0, 1, 2])},
        {"placement": np.array([1.0, 1.0, 2.0])},
        {"endpoint": np.zeros((3, 4))},
        {"label": ("1", "1", "1")},
        {"label": ("1", "", "1")},
        {"label": ("1", " 2", "1")},
        {"notes": ("a",)},
    ],
)
def test_invalid_arguments_are_rejected(change, approve):
    with pytest.raises(ValueError) as error:  # noqa: PT011 - its text is approved
        pose_set(**change)
    approve(str(error.value))


def test_digest_ignores_order_notes_and_times():
    p, order = pose_set(), [2, 0, 1]
    reordered = pose_set(
        **{
            name: getattr(p, name)[order]
            for name in ("placement", "q_rad", "sd_rad", "samples", "endpoint")
        },
        label=tuple(p.label[k] for k in order),
        notes=None,
        utc=None,
    )
    assert reordered.sha256() == p.sha256()
    assert pose_set(q_rad=-0.0 * p.q_rad).sha256() == pose_set(q_rad=0.0 * p.q_rad).sha256()


@pytest.mark.parametrize(
    "change",
    [
        {"q_rad": np.nextafter(np.arange(6.0), 9.0).reshape(3, 2)},
        {"sd_rad": None},
        {"sd_rad": np.zeros((3, 2))},
        {"samples": None},
        {"samples": np.array([32, 32, 17])},
        {"endpoint": None},
        {"endpoint": np.ones((3, 3))},
        {"label": ("1", "3", "1")},
        {"placement": np.array([1, 1, 3])},
    ],
)
def test_digest_depends_on_every_number_a_calibration_uses(change):
    assert pose_set(**change).sha256() != pose_set().sha256()


def test_digest_is_independent_of_the_machine():
    assert pose_set().sha256() == "4ab8a7e8f212833502b7ad33b333e0a0407ff08a94ed61ab3d66d1470b9f52d3"


@pytest.mark.parametrize("seed", range(3))
def test_held_out_parts_are_independent_of_pose_order(seed):
    q = np.random.default_rng(5).uniform(-1.0, 1.0, (30, 7))
    shuffle = np.random.default_rng(seed).permutation(len(q))
    for part, shuffled in zip(fold_poses(q), fold_poses(q[shuffle]), strict=True):
        assert set(shuffle[shuffled]) == set(part)
    assert set(shuffle[far_block(q[shuffle])]) == set(far_block(q))
