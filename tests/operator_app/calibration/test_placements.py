"""Indistinguishable placements and measured distances between sockets."""

from dataclasses import replace

import numpy as np
import pytest

from fixtures.ball import KnownDistance
from operator_app.calibration.acceptance import Verdict
from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.placements import indistinguishable_placements
from operator_app.calibration.prediction import concatenated_poses
from operator_app.report.facts import facts_of
from operator_app.report.text import facts_text
from tests.oracles.as_shipped import ARM, BALL, HINGE, PANDA, panda_poses, poses_of
from tests.oracles.shop_floor import Sizes, Specimen, walked

CODE = "SAME_PLACEMENT"


@pytest.fixture(scope="module")
def two_sockets():
    """A real arm with its ball in two sockets, the first of which is numbered as three."""
    poses = panda_poses(1, 2)
    placement = np.where(poses.placement == 1, np.arange(len(poses.label)) % 3 + 1, 4)
    return calibrate(PANDA, BALL, replace(poses, placement=placement), drop=True)


def remounted(seed, *, turned_deg, shifted_m):
    """A calibration from 20 poses in one hinge and 20 after remounting it."""
    first, rng = Specimen.drawn(seed, Sizes()), np.random.default_rng([seed, 2])
    changes = {n: shifted_m * rng.choice([-1, 1]) for n in ("a_0", "s_0", "a_7", "s_7")}
    changes |= {n: np.deg2rad(turned_deg) * rng.choice([-1, 1]) for n in ("alpha_0", "alpha_7")}
    chain = first.chain
    second = replace(
        first, chain=chain.changed(**{n: chain.value(n) + d for n, d in changes.items()})
    )
    walks = [walked(specimen, 20, walk=k) for k, specimen in enumerate((first, second))]
    poses = [replace(poses_of(w), placement=np.full(20, k)) for k, w in enumerate(walks, 1)]
    return calibrate(ARM, HINGE, concatenated_poses(*poses))


def test_one_socket_numbered_as_three_is_noticed_and_accepted(two_sockets):
    (notice,) = [n for n in two_sockets.warnings if n.code == CODE]
    assert notice.joints == (1, 2, 3)
    assert two_sockets.accepted
    facts = facts_of(two_sockets)
    assert {"code": CODE, "text": notice.sentence} in facts.data["warnings"]
    assert "do not differ clearly" in " ".join(facts_text(facts).split())


@pytest.mark.sample(2)
@pytest.mark.parametrize("seed", [1100, 1101])
@pytest.mark.parametrize(
    ("turned_deg", "shifted_m", "warned"), [(0.0, 0.0, True), (0.5, 1e-3, False)]
)
def test_remounting_by_a_millimetre_is_distinguished(seed, turned_deg, shifted_m, warned):
    solution = remounted(seed, turned_deg=turned_deg, shifted_m=shifted_m)
    assert [n.code for n in solution.warnings].count(CODE) == warned
    assert solution.accepted


def test_zero_uncertainty_distinguishes_any_difference(two_sockets):
    model, estimate = two_sockets.model, two_sockets.estimate
    exact = np.zeros_like(estimate.covariance)
    assert indistinguishable_placements(model, replace(estimate, covariance=exact)) == ()
    own = model.columns(1) != model.columns(2)
    same = estimate.x.copy()
    same[model.columns(2)[own]] = same[model.columns(1)[own]]
    (finding,) = indistinguishable_placements(model, replace(estimate, x=same, covariance=exact))
    assert (finding.joints, finding.size, finding.figures) == ((1, 2), 0.0, {"sigmas": 0.0})


def test_single_placement_gives_no_notice(two_sockets):
    model, _ = two_sockets.model.of(1)
    assert indistinguishable_placements(model, two_sockets.estimate) == ()


BLOCK_M = 0.05


def with_distances(*distances):
    return calibrate(PANDA, replace(BALL, distances=distances), panda_poses(3, 4))


@pytest.fixture(scope="module")
def unmeasured():
    return with_distances()


def test_poses_alone_determine_the_distance(unmeasured):
    (distance,) = unmeasured.distances
    assert distance.between == (3, 4)
    assert distance.measured is None
    assert abs(distance.value_m - BLOCK_M) < 3.0 * distance.sigma_m
    assert 5e-5 < distance.sigma_m < 5e-4


def test_measured_distance_counts_as_one_observation(unmeasured):
    known = KnownDistance(between=(4, 3), value_m=BLOCK_M, sigma_m=1e-4)
    solution = with_distances(known, KnownDistance(between=(1, 2), value_m=0.9, sigma_m=1e-5))
    (alone,), (distance,) = unmeasured.distances, solution.distances
    share = alone.sigma_m**2 / (alone.sigma_m**2 + known.sigma_m**2)
    # Error sizes are learned again: a tenth of the shift.
    moved = BLOCK_M - alone.value_m
    assert distance.value_m - alone.value_m == pytest.approx(share * moved, abs=0.1 * abs(moved))
    assert distance.sigma_m == pytest.approx(share**0.5 * known.sigma_m, rel=0.1)
    spread = (alone.sigma_m**2 + known.sigma_m**2) ** 0.5
    assert distance.deviation == pytest.approx(moved / spread, abs=0.1)
    (unused,) = (n for n in solution.warnings if n.code.startswith("DISTANCE"))
    assert (unused.code, unused.names, unused.joints) == ("DISTANCE_UNUSED", ("1 and 2",), (3, 4))
    assert solution.components.budget["distances"].max() > 0.0


@pytest.mark.parametrize(
    ("error_m", "codes"),
    [(2e-3, ["DISTANCE"]), (2e-2, ["DISTANCE", "STEP_JOINT_1"]), (0.45, ["DISTANCE"])],
)
def test_contradicted_distance_is_the_first_cause_of_a_refusal(error_m, codes):
    known = KnownDistance(between=(3, 4), value_m=BLOCK_M + error_m, sigma_m=1e-4)
    solution = with_distances(known)
    assert [c.code for c in solution.causes][: len(codes)] == codes
    assert solution.verdict is Verdict.NOT_ACCEPTED
    assert solution.distances[0].deviation > 4.0
