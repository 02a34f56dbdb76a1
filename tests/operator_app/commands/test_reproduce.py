"""`sarcal reproduce`: its poses close the loop of the specimen, its figures agree with the paper."""

import numpy as np
import pytest

from hardware.virtual.scenarios import scenario
from operator_app.config.procedure_file import load_procedure
from operator_app.planning.reproduction import capture_specimen
from tests.oracles.fault_session import loop_error

PRINTED = {"theta_off_2": -122.8, "s_1": 0.273, "alpha_7": 99.8, "a_0": 0.202}
"""From Table 2."""


def test_poses_of_exact_specimen_close_its_true_loop():
    specimen = capture_specimen(load_procedure("hinge"), scenario("exact"), poses=3)
    # A count of an encoder is 1.6e-5 rad.
    assert all(loop_error(q_rad) < 3e-5 for q_rad in specimen.q_rad)
    assert np.ptp(specimen.q_rad[:, 0]) > 0.02
    assert np.ptp(specimen.q_rad[:, 2]) > 0.02, "a free joint did not follow"


@pytest.mark.campaign
def test_reproduction_matches_the_paper(run_command):
    reproduction = run_command(0, "reproduce", "--json").json
    for name, value in PRINTED.items():
        assert reproduction["table_2"][name]["paper"] == pytest.approx(value)
    assert reproduction["sigma_pos_mm"]["rms"] == pytest.approx(2.7, rel=0.15)
    assert reproduction["sigma_ori_mrad"]["rms"] == pytest.approx(6.6, rel=0.15)
    assert reproduction["scaled_condition_number"] < 100
    shares = {row["source"]: row["sigma_pos_mm"] for row in reproduction["shares"]}
    together = shares.pop("all together")
    assert max(shares, key=shares.__getitem__) == "RVDT curves of the wrist"
    assert together > max(shares.values())
    remaining_deg = {row["remedy"]: row["offsets_rms_deg"] for row in reproduction["remedies"]}
    assert min(remaining_deg, key=remaining_deg.__getitem__) == "all three"
    assert remaining_deg["all three"] < 0.05 < remaining_deg["as it is, implicit"]
    assert remaining_deg["as it is, implicit"] < remaining_deg["as it is, the paper's estimator"]
