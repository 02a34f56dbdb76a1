"""What version 2 of the parameters document brought: sides, corrections, correlations, budgets; and what it reads."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from hardware.canopen.objects import MAX_JOINTS
from hardware.virtual.sdo_server import LONGEST_DOCUMENT
from operator_app.config.any_file import json_schema
from operator_app.config.parameter_records import (
    CalibratedEntry,
    Correction,
    DhRow,
    JointParameters,
    RvdtRemedy,
    Side,
    budget_of,
    correlations_of,
)
from operator_app.config.parameters_file import format_parameters, parse_parameters
from operator_app.config.schema import schema_name
from tests.oracles.mistakes import one_mistake, problems_of
from tests.oracles.parameter_documents import GOOD, document, parse


def test_version_1_is_still_read_and_has_neither_side_nor_correction():
    found = parse_parameters(GOOD.replace("sarcal/parameters/2", "sarcal/parameters/1", 1).encode())
    assert found == document()
    assert {entry.side for entry in found.calibrated} == {None}
    assert found.rvdt == ()
    assert (found.correlations, found.budget) == ({}, {})


KEYS_OF_VERSION_3 = {
    "ParametersDocument": "arm budget calibrated correlations dh estimator fixture forced joints "
    "pose_set_sha256 quality rvdt schema software_version utc warnings",
    "WhichArm": "model serial",
    "WhichFixture": "kind name",
    "JointParameters": "home_offset_counts joint sigma_deg theta_off_deg",
    "DhRow": "a_m alpha_deg beta_deg row s_m theta_off_deg",
    "CalibratedEntry": "entry side sigma_deg sigma_m",
    "Quality": "chi2_per_dof poses rank scaled_condition_number sigma_ori_mrad sigma_pos_mm",
    "TwoFigures": "as_printed rms",
    "DocumentWarning": "code text",
    "RvdtRemedy": "gain joint table theta_off_deg",
    "Correction": "add_deg reading_deg sigma_deg",
}


def test_a_key_that_comes_raises_the_number_of_the_schema():
    """A program that reads version 3 refuses other keys: with a new one, write VERSIONS (1, 2, 3, 4)."""
    models = json_schema("parameters")["$defs"]
    found = {
        name: " ".join(sorted(m["properties"])) for name, m in models.items() if "properties" in m
    }
    assert schema_name("parameters") == "sarcal/parameters/3"
    assert found == KEYS_OF_VERSION_3


def test_only_a_document_with_a_beta_is_of_version_3():
    plain = document()
    rows = (*plain.dh[:2], replace(plain.dh[2], beta_deg=0.05), *plain.dh[3:])
    twisted = replace(plain, dh=rows)
    assert b"schema: sarcal/parameters/2\n" in format_parameters(plain)
    written = format_parameters(twisted)
    assert b"schema: sarcal/parameters/3\n" in written
    assert parse_parameters(written) == twisted
    assert twisted.table.beta_rad[2] == np.deg2rad(0.05)


def test_a_key_of_a_newer_program_is_told_from_a_misspelt_one():
    newer, misspelt = problems_of(parse, GOOD + "thermal: {}\nforcd: no\n")
    assert (newer.key, newer.text) == ("thermal", "unknown key")
    assert "a newer sarcal may have written it" in newer.remedy
    assert misspelt.remedy == "did you mean forced?"


def with_a_remedy():
    rows = ((-260.0, 0.1, 0.01), (-230.5, 1.0 / 3.0, 0.01), (-200.0, -0.2, 0.02))
    table = tuple(Correction(reading_deg=r, add_deg=a, sigma_deg=s) for r, a, s in rows)
    remedy = RvdtRemedy(joint=6, theta_off_deg=116.3, gain=0.98, table=table)
    sides: tuple[Side, ...] = ("arm", "ground", "hand")
    listed = tuple(
        replace(entry, side=sides[k % 3]) for k, entry in enumerate(document().calibrated)
    )
    return replace(document(), rvdt=(remedy,), calibrated=listed, forced="the wrist is new")


def test_what_version_2_brings_reads_back_the_same():
    written = format_parameters(with_a_remedy())
    assert parse_parameters(written) == with_a_remedy()
    data = yaml.safe_load(written)
    assert data["schema"] == "sarcal/parameters/2"
    assert data["rvdt"][0]["table"][1] == {
        "reading_deg": -230.5, "add_deg": 1.0 / 3.0, "sigma_deg": 0.01,
    }  # fmt: skip
    assert data["calibrated"][1]["side"] == "ground"
    assert data["forced"] == "the wrist is new"


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("reading_deg: -230.5", "reading_deg: -270.5", "rvdt[joint 6].table"),
        ("joint: 6\n", "joint: 8\n", "rvdt[joint 8].joint"),
        ("gain: 0.98", "gain: 0", "rvdt[joint 6].gain"),
        ("side: ground", "side: table", "calibrated[theta_off_2].side"),
    ],
)  # fmt: skip
def test_one_mistake_in_a_remedy_gives_one_complaint(old, new, key, approve):
    problem = one_mistake(parse, format_parameters(with_a_remedy()).decode(), old, new)
    assert problem.key == key
    approve(str(problem))


def with_correlations():
    names = [entry.entry for entry in document().calibrated]
    rng = np.random.default_rng(3)
    spread = rng.normal(size=(len(names), len(names)))
    covariance = spread @ spread.T
    parts = {
        "lengths": 0.25 * np.diagonal(covariance),
        "fixture_give": 0.75 * np.diagonal(covariance),
    }
    return replace(
        document(),
        correlations=correlations_of(names, covariance),
        budget=budget_of(names, np.diagonal(covariance), {**parts, "sag": np.zeros(len(names))}),
    )


def test_correlations_and_budget_read_back_the_same():
    written = format_parameters(with_correlations())
    assert parse_parameters(written) == with_correlations()
    data = yaml.safe_load(written)
    assert list(data["correlations"]) == [e["entry"] for e in data["calibrated"]][1:]
    assert [len(row) for row in data["correlations"].values()] == list(range(1, 14))
    assert data["budget"]["theta_off_1"] == {"lengths": 0.25, "fixture_give": 0.75}


def test_a_parameter_without_variance_goes_with_none_and_has_no_budget():
    covariance = np.diag([4.0, 0.0, 1.0])
    covariance[0, 2] = covariance[2, 0] = -1.0
    assert correlations_of(("a", "b", "c"), covariance) == {"b": (0.0,), "c": (-0.5, 0.0)}
    parts = {"lengths": np.array([1.0, 0.0, 1.0]), "sag": np.array([3.0, 0.0, 0.0])}
    assert budget_of(("a", "b", "c"), np.diagonal(covariance), parts) == {
        "a": {"lengths": 0.25, "sag": 0.75},
        "c": {"lengths": 1.0},
    }


@pytest.mark.parametrize(
    ("old", "new", "key"),
    [
        ("  theta_off_3: [", "  theta_off_3: [0.5, ", "correlations.theta_off_3"),
        ("  theta_off_3: [", "  theta_off_9: [", "correlations"),
        ("  theta_off_3: [", "  theta_off_3: [1", "correlations.theta_off_3[1]"),
        ("{lengths: 0.25,", "{lengths: 1.25,", "budget.theta_off_1.lengths"),
        ("{lengths: 0.25,", "{lengths: 0.2,", "budget.theta_off_1"),
        ("  theta_off_1: {lengths", "  theta_off_8: {lengths", "budget.theta_off_8"),
    ],
)  # fmt: skip
def test_one_mistake_in_them_gives_one_complaint(old, new, key, approve):
    problem = one_mistake(parse, format_parameters(with_correlations()).decode(), old, new)
    assert problem.key == key
    approve(str(problem))


def test_the_longest_document_there_can_be_fits_into_a_slot():
    """As many joints as a bus has, every entry calibrated, sixteen sources in each budget."""
    n = MAX_JOINTS
    names = [f"{kind}_{k}" for kind in ("theta_off", "s", "a", "alpha") for k in range(n + 1)]
    odd = 1.0 / 3.0
    rows = tuple(
        DhRow(row=k, theta_off_deg=odd, s_m=odd, a_m=odd, alpha_deg=odd) for k in range(n + 1)
    )
    rng = np.random.default_rng(4)
    spread = rng.normal(size=(len(names), len(names)))
    variance = np.ones(len(names))
    longest = replace(
        document(),
        joints=tuple(
            JointParameters(joint=k, theta_off_deg=odd, sigma_deg=odd, home_offset_counts=-(2**31))
            for k in range(1, n + 1)
        ),
        dh=rows,
        calibrated=tuple(CalibratedEntry.of(name, odd, "ground") for name in names),
        correlations=correlations_of(names, -spread @ spread.T),
        budget=budget_of(names, variance, {f"a_long_source_{k}": variance / 16 for k in range(16)}),
    )
    assert len(format_parameters(longest)) < LONGEST_DOCUMENT / 2
