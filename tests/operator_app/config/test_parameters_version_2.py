"""Versions of the parameters document: sides, corrections, correlations and budgets since 2, beta since 3."""

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
from tests.oracles.mistakes import parse_problems, single_problem
from tests.oracles.parameter_documents import GOOD, document, parse


def test_version_1_is_read_without_side_and_correction():
    document_1 = parse_parameters(
        GOOD.replace("sarcal/parameters/2", "sarcal/parameters/1", 1).encode()
    )
    assert document_1 == document()
    assert {entry.side for entry in document_1.calibrated} == {None}
    assert document_1.rvdt == ()
    assert (document_1.correlations, document_1.budget) == ({}, {})


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


def test_new_key_requires_a_new_schema_version():
    """A program that reads version 3 refuses other keys: with a new one, write VERSIONS (1, 2, 3, 4)."""
    models = json_schema("parameters")["$defs"]
    keys = {
        name: " ".join(sorted(m["properties"])) for name, m in models.items() if "properties" in m
    }
    assert schema_name("parameters") == "sarcal/parameters/3"
    assert keys == KEYS_OF_VERSION_3


def test_only_document_with_beta_has_version_3():
    plain = document()
    rows = (*plain.dh[:2], replace(plain.dh[2], beta_deg=0.05), *plain.dh[3:])
    with_beta = replace(plain, dh=rows)
    assert b"schema: sarcal/parameters/2\n" in format_parameters(plain)
    written = format_parameters(with_beta)
    assert b"schema: sarcal/parameters/3\n" in written
    assert parse_parameters(written) == with_beta
    assert with_beta.table.beta_rad[2] == np.deg2rad(0.05)


def test_key_of_newer_version_differs_from_misspelt_key():
    newer, misspelt = parse_problems(parse, GOOD + "thermal: {}\nforcd: no\n")
    assert (newer.key, newer.text) == ("thermal", "unknown key")
    assert "a newer sarcal may have written it" in newer.remedy
    assert misspelt.remedy == "did you mean forced?"


def full_document():
    """A document with sides, an RVDT correction, correlations and a budget."""
    rows = ((-260.0, 0.1, 0.01), (-230.5, 1.0 / 3.0, 0.01), (-200.0, -0.2, 0.02))
    table = tuple(Correction(reading_deg=r, add_deg=a, sigma_deg=s) for r, a, s in rows)
    remedy = RvdtRemedy(joint=6, theta_off_deg=116.3, gain=0.98, table=table)
    sides: tuple[Side, ...] = ("arm", "ground", "hand")
    calibrated = tuple(
        replace(entry, side=sides[k % 3]) for k, entry in enumerate(document().calibrated)
    )
    names = [entry.entry for entry in calibrated]
    factor = np.random.default_rng(3).normal(size=(len(names), len(names)))
    covariance = factor @ factor.T
    variance = np.diagonal(covariance)
    parts = {"lengths": 0.25 * variance, "fixture_give": 0.75 * variance, "sag": 0.0 * variance}
    return replace(
        document(),
        rvdt=(remedy,),
        calibrated=calibrated,
        forced="the wrist is new",
        correlations=correlations_of(names, covariance),
        budget=budget_of(names, variance, parts),
    )


def test_full_document_is_read_back():
    written = format_parameters(full_document())
    assert parse_parameters(written) == full_document()
    data = yaml.safe_load(written)
    assert data["schema"] == "sarcal/parameters/2"
    assert data["rvdt"][0]["table"][1] == {
        "reading_deg": -230.5, "add_deg": 1.0 / 3.0, "sigma_deg": 0.01,
    }  # fmt: skip
    assert data["calibrated"][1]["side"] == "ground"
    assert data["forced"] == "the wrist is new"
    assert list(data["correlations"]) == [e["entry"] for e in data["calibrated"]][1:]
    assert [len(row) for row in data["correlations"].values()] == list(range(1, 14))
    assert data["budget"]["theta_off_1"] == {"lengths": 0.25, "fixture_give": 0.75}


def test_parameter_without_variance_is_uncorrelated_without_budget():
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
        ("reading_deg: -230.5", "reading_deg: -270.5", "rvdt[joint 6].table"),
        ("joint: 6\n", "joint: 8\n", "rvdt[joint 8].joint"),
        ("gain: 0.98", "gain: 0", "rvdt[joint 6].gain"),
        ("side: ground", "side: table", "calibrated[theta_off_2].side"),
        ("  theta_off_3: [", "  theta_off_3: [0.5, ", "correlations.theta_off_3"),
        ("  theta_off_3: [", "  theta_off_9: [", "correlations"),
        ("  theta_off_3: [", "  theta_off_3: [1", "correlations.theta_off_3[1]"),
        ("{lengths: 0.25,", "{lengths: 1.25,", "budget.theta_off_1.lengths"),
        ("{lengths: 0.25,", "{lengths: 0.2,", "budget.theta_off_1"),
        ("  theta_off_1: {lengths", "  theta_off_8: {lengths", "budget.theta_off_8"),
    ],
)  # fmt: skip
def test_one_mistake_gives_one_problem(old, new, key, approve):
    problem = single_problem(parse, format_parameters(full_document()).decode(), old, new)
    assert problem.key == key
    approve(str(problem))


def test_longest_document_fits_into_a_slot():
    """All joints of a bus, every entry calibrated, sixteen sources in each budget."""
    n = MAX_JOINTS
    names = [f"{kind}_{k}" for kind in ("theta_off", "s", "a", "alpha") for k in range(n + 1)]
    value = 1.0 / 3.0
    rows = tuple(
        DhRow(row=k, theta_off_deg=value, s_m=value, a_m=value, alpha_deg=value)
        for k in range(n + 1)
    )
    rng = np.random.default_rng(4)
    factor = rng.normal(size=(len(names), len(names)))
    variance = np.ones(len(names))
    longest = replace(
        document(),
        joints=tuple(
            JointParameters(
                joint=k, theta_off_deg=value, sigma_deg=value, home_offset_counts=-(2**31)
            )
            for k in range(1, n + 1)
        ),
        dh=rows,
        calibrated=tuple(CalibratedEntry.of(name, value, "ground") for name in names),
        correlations=correlations_of(names, -factor @ factor.T),
        budget=budget_of(names, variance, {f"a_long_source_{k}": variance / 16 for k in range(16)}),
    )
    assert len(format_parameters(longest)) < LONGEST_DOCUMENT / 2
