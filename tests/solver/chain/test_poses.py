"""Pose sets: shapes, read-only arrays, and a digest of what a calibration uses."""

from typing import Any

import numpy as np
import pytest

from solver.chain.poses import PoseSet
from solver.diagnostics.cross_validation import far_block, fold_poses
from solver.estimators.error_model import stated_errors
from solver.estimators.estimate import Estimate
from solver.estimators.implicit import NoiseModel, estimate_implicit
from solver.estimators.paper import estimate_paper
from solver.estimators.variance_components import estimate_with_errors
from tests.oracles.loop_oracle import Truth
from tests.oracles.simulated_loops import Simulation
from tests.solver.conftest import loop_of, paper_arm


def poses(**changes: Any) -> PoseSet:
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


def test_facts():
    p = poses()
    assert len(p) == 3
    assert p.joint_count == 2
    assert p.keys == ((1, "1"), (1, "2"), (2, "1"))
    assert p.placements == (1, 2)


def test_arrays_are_copies_and_read_only():
    q = np.zeros((3, 2))
    p = poses(q_rad=q)
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
def test_wrong_calls(change, approve):
    with pytest.raises(ValueError) as refused:  # noqa: PT011 - its words are approved
        poses(**change)
    approve(str(refused.value))


def test_digest_does_not_depend_on_order_notes_or_times():
    p, order = poses(), [2, 0, 1]
    turned = poses(
        **{
            name: getattr(p, name)[order]
            for name in ("placement", "q_rad", "sd_rad", "samples", "endpoint")
        },
        label=tuple(p.label[k] for k in order),
        notes=None,
        utc=None,
    )
    assert turned.sha256() == p.sha256()
    assert poses(q_rad=-0.0 * p.q_rad).sha256() == poses(q_rad=0.0 * p.q_rad).sha256()


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
def test_digest_sees_every_number_a_calibration_uses(change):
    assert poses(**change).sha256() != poses().sha256()


def test_digest_is_the_same_on_every_machine():
    assert poses().sha256() == "4ab8a7e8f212833502b7ad33b333e0a0407ff08a94ed61ab3d66d1470b9f52d3"


SIMULATION = Simulation(poses=30, wrist_sd=6e-3)
Q = SIMULATION.readings(0)
NOISE = NoiseModel(joint_variance=SIMULATION.sigma() ** 2)


def fitted(by: str, truth: Truth, order: np.ndarray) -> tuple[Estimate, list[float]]:
    """The estimate of the readings in that order, and what it found of the sizes of errors."""
    model, q = loop_of(truth), Q[order]
    match by:
        case "paper":
            return estimate_paper(model, q), []
        case "implicit":
            own = NOISE.joint_variance * np.linspace(0.5, 2.0, len(Q))[:, None]
            return estimate_implicit(model, q, NoiseModel(joint_variance=own[order])), []
        case _:
            errors = stated_errors(paper_arm(truth), samples=np.ones(len(Q), dtype=np.int64))
            whole = estimate_with_errors(model, q, errors.at_poses(order))
            return whole.estimate, [c.sd for c in whole.components.components]


@pytest.fixture(params=range(3))
def shuffle(request):
    return np.random.default_rng(request.param).permutation(len(Q))


@pytest.mark.parametrize("by", ["paper", "implicit", "components"])
def test_no_estimator_knows_the_order_of_its_poses(by, truth, shuffle):
    (one, sizes), (other, others) = (fitted(by, truth, o) for o in (np.arange(len(Q)), shuffle))
    assert other.x == pytest.approx(one.x, rel=1e-12)
    assert other.covariance == pytest.approx(one.covariance, rel=1e-12)
    assert other.sigmas.position_m.rms == pytest.approx(one.sigmas.position_m.rms, rel=1e-12)
    assert other.residual == pytest.approx(one.residual[shuffle], rel=1e-12)
    assert others == pytest.approx(sizes, rel=1e-12)
    if one.chi2 is not None:
        assert other.chi2 == pytest.approx(one.chi2, rel=1e-12)
        assert other.pose_chi2 == pytest.approx(one.pose_chi2[shuffle], rel=1e-12)
        assert other.corrections == pytest.approx(one.corrections[shuffle], rel=1e-12)


def test_nor_do_the_parts_that_are_held_out(shuffle):
    for one, other in zip(fold_poses(Q, 5), fold_poses(Q[shuffle], 5), strict=True):
        assert set(shuffle[other]) == set(one)
    assert set(shuffle[far_block(Q[shuffle])]) == set(far_block(Q))
