"""`sarcal reproduce`: the poses it takes are of the specimen, and its figures are of the paper's size."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from hardware.virtual.scenarios import scenario
from operator_app.config.procedure_file import load_procedure
from operator_app.planning.reproduction import capture_specimen
from tests.oracles.loop_oracle import closure, paper_truth

PRINTED = {"theta_off_2": -122.8, "s_1": 0.273, "alpha_7": 99.8, "a_0": 0.202}
"""From Table 2."""


def test_poses_of_an_exact_specimen_close_its_true_loop():
    """By an independent chain: at some hinge angle every pose comes back to the hinge."""
    procedure = load_procedure("hinge")
    taken = capture_specimen(procedure, scenario("exact"), poses=3)
    truth = paper_truth()
    for q in taken.q_rad:

        def miss(hinge_rad: float, q: np.ndarray = q) -> float:
            angles = np.concatenate(([hinge_rad], q))
            return float(np.linalg.norm(closure(truth, angles)))

        start = min(np.linspace(-np.pi, np.pi, 73), key=miss)
        found = minimize_scalar(miss, bounds=(start - 0.1, start + 0.1), method="bounded",
                                options={"xatol": 1e-9})  # fmt: skip
        assert found.fun < 5e-5  # rad and m: a count of an encoder is 1.6e-5 rad
    assert np.ptp(taken.q_rad[:, 0]) > 0.02
    assert np.ptp(taken.q_rad[:, 2]) > 0.02, "a free joint did not follow"


@pytest.mark.campaign
def test_the_paper_by_one_command(ends_with):
    found = ends_with(0, "reproduce", "--json").json
    for name, value in PRINTED.items():
        assert found["table_2"][name]["paper"] == pytest.approx(value)
    assert found["sigma_pos_mm"]["rms"] == pytest.approx(2.7, rel=0.15)
    assert found["sigma_ori_mrad"]["rms"] == pytest.approx(6.6, rel=0.15)
    assert found["scaled_condition_number"] < 100
    shares = {row["source"]: row["sigma_pos_mm"] for row in found["shares"]}
    together = shares.pop("all together")
    assert max(shares, key=shares.__getitem__) == "RVDT curves of the wrist"
    assert together > max(shares.values())
    left = {row["remedy"]: row["offsets_rms_deg"] for row in found["remedies"]}
    assert min(left, key=left.__getitem__) == "all three"
    assert left["all three"] < 0.05 < left["as it is, implicit"]
    assert left["as it is, implicit"] < left["as it is, the paper's estimator"]


@pytest.mark.parametrize("poses", ["7", "121"])
def test_a_number_of_poses_that_says_nothing_is_refused(poses, ends_with):
    assert "between 8 and 120" in ends_with(2, "reproduce", "--poses", poses).err
