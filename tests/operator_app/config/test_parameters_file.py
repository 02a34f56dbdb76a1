"""Parameters document: written and read back bit for bit, a modified one is refused; its versions 1 to 3."""

import math
from dataclasses import replace
from datetime import UTC

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.canopen.objects import MAX_JOINTS
from hardware.virtual.sdo_server import LONGEST_DOCUMENT
from operator_app.config.any_file import json_schema
from operator_app.config.arm_file import load_arm
from operator_app.config.errors import ConfigError
from operator_app.config.fixture_file import load_fixture
from operator_app.config.parameter_records import (
    CalibratedEntry,
    Correction,
    DhRow,
    DocumentWarning,
    JointParameters,
    RvdtRemedy,
    Side,
    TwoFigures,
    WhichArm,
    budget_of,
    correlations_of,
)
from operator_app.config.parameters_file import format_parameters, parse_parameters, rows_from_table
from operator_app.config.schema import schema_name
from solver.chain.kinematics import DhTable
from tests.oracles.identity import same
from tests.oracles.mistakes import named, parse_problems, single_problem
from tests.oracles.parameter_documents import GOOD, document, parse


class TestContent:
    def test_plain_yaml_reader_reads_the_same_numbers(self):
        data = yaml.safe_load(GOOD)
        assert next(iter(data)) == "schema"
        assert data["arm"] == {"model": "sarcos_dextrous", "serial": "SDA-0007"}
        assert [row["row"] for row in data["dh"]] == list(range(8))
        assert data["dh"][3]["s_m"] == 0.355
        assert data["dh"][0] == {
            "row": 0, "theta_off_deg": 0.0, "s_m": 0.01, "a_m": 0.2, "alpha_deg": -40.0,
        }  # fmt: skip
        assert [j["theta_off_deg"] for j in data["joints"]] == [10, -120, -20, -10, 30, 120, 90]

    def test_home_offsets_are_rounded_to_sensor_counts(self):
        counts = [joint.home_offset_counts for joint in document().joints]
        encoder = [round(deg / 360.0 * 400000) for deg in (10, -120, -20, -10, 30)]
        rvdt = [round(deg / 120.0 * 4096) for deg in (120, 90)]
        assert counts == encoder + rvdt

    def test_table_is_that_of_the_loop_in_si(self):
        table = load_fixture("hinge").fixture.model(load_arm("sarcos_dextrous")).table
        np.testing.assert_array_equal(document().table.stacked(), table.stacked())
        np.testing.assert_array_equal(document().theta_off_rad, table.theta_off_rad[1:])


# Old text, new text, key of the problem.
BAD = [
    ("a_m: 0.2,", "a_m: -38.5,", "dh[row 0].a_m"),
    ("a_m: 0.2,", "a_mm: 200,", "dh[row 0].a_mm"),
    ("a_m: 0.2,", "", "dh[row 0].a_m"),
    ("{joint: 1, theta_off_deg: 10.0", "{joint: 1, theta_off_deg: 10.5", "dh[row 1].theta_off_deg"),
    ("{joint: 1, theta_off_deg: 10.0", "{joint: 1, theta_off_deg: 400", "joints[joint 1].theta_off_deg"),
    ("sigma_deg: 0.001,", "sigma_deg: -0.001,", "joints[joint 1].sigma_deg"),
    ("sigma_deg: 0.001,", "sigma_deg: 0.002,", "calibrated[theta_off_1]"),
    ("{entry: theta_off_1, sigma_deg: 0.001}", "{entry: theta_off_1, sigma_m: 0.001}",
     "calibrated[theta_off_1]"),
    ("entry: a_0", "entry: b_0", "calibrated[b_0].entry"),
    ("entry: a_0", "entry: a_9", "calibrated[a_9]"),
    ("entry: a_0", "entry: s_0", "calibrated[s_0]"),
    ("home_offset_counts: 11111}", "home_offset_counts: 11111.5}",
     "joints[joint 1].home_offset_counts"),
    ("home_offset_counts: 11111}", "home_offset_counts: 3000000000}",
     "joints[joint 1].home_offset_counts"),
    ("joint: 2,", "joint: 3,", "joints[joint 3].joint"),
    ("row: 2,", "row: 3,", "dh[row 3].row"),
    ("estimator: paper", "estimator: best", "estimator"),
    ("12:00:00.250000Z", "12:00:00+01:00", "utc"),
    ("2026-01-31", "2026-02-31", "utc"),
    ("0123456789abcdef0123", "XYZ\t456789abcdef0123", "pose_set_sha256"),
    ("serial: SDA-0007", "serial: ''", "arm.serial"),
    ("serial: SDA-0007", "serial: 7", "arm.serial"),
    ("rank: 14", "rank: 15", "quality.rank"),
    ("rank: 14", "rank: 14\n  grade: A", "quality.grade"),
    ("scaled_condition_number: 33.1", "scaled_condition_number: .inf",
     "quality.scaled_condition_number"),
    ("code: RVDT_LINEARITY", "code: r v", "warnings[1].code"),
    ("schema: sarcal/parameters/2", "schema: sarcal/arm/1", "schema"),
    ("schema: sarcal/parameters/2", "schema: sarcal/parameters/4", "schema"),
]  # fmt: skip


BAD_FULL = [
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
]


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


FULL = format_parameters(full_document()).decode()


@pytest.mark.parametrize(
    ("good", "old", "new", "key"),
    [*((GOOD, *case) for case in BAD), *((FULL, *case) for case in BAD_FULL)],
    ids=named([*BAD, *BAD_FULL]),
)
def test_one_mistake_gives_one_problem(good, old, new, key, approve):
    problem = single_problem(parse, good, old, new)
    assert problem.key == key
    approve(str(problem))


def test_infinite_number_or_implausible_length_cannot_be_written():
    quality = replace(document().quality, scaled_condition_number=math.inf)
    with pytest.raises(ConfigError, match="the result: inf cannot be written") as caught:
        format_parameters(replace(document(), quality=quality))
    assert len(caught.value.problems) == 1
    rows = (replace(document().dh[0], a_m=1e6), *document().dh[1:])
    with pytest.raises(ConfigError, match=r"^the result: dh\[row 0\]\.a_m: .*cannot be exported"):
        format_parameters(replace(document(), dh=rows))


FLOAT = st.floats(-360.0, 360.0)
LENGTH = st.floats(-10.0, 10.0)
SIGMA = st.floats(0.0, 1e6)
WORD = st.text(min_size=1, max_size=20, alphabet=st.characters(exclude_categories=("Cs",)))


@st.composite
def documents(draw):
    """Any figures and words in a document of seven joints."""
    template = document()

    def varied(value, **strategies):
        return replace(value, **{name: draw(strategy) for name, strategy in strategies.items()})

    rows = tuple(
        varied(row, theta_off_deg=FLOAT, s_m=LENGTH, a_m=LENGTH, alpha_deg=FLOAT)
        for row in template.dh
    )
    calibrated = tuple(CalibratedEntry.of(e.entry, draw(SIGMA)) for e in template.calibrated)
    sigma = {e.entry: e.sigma for e in calibrated}
    joints = tuple(
        JointParameters(
            joint=k,
            theta_off_deg=row.theta_off_deg,
            sigma_deg=sigma.get(f"theta_off_{k}"),
            home_offset_counts=draw(st.none() | st.integers(-(2**31), 2**31 - 1)),
        )
        for k, row in enumerate(rows[1:], 1)
    )
    figures = st.builds(TwoFigures, rms=SIGMA, as_printed=SIGMA)
    quality = varied(
        template.quality,
        scaled_condition_number=st.floats(1.0, 1e300),
        sigma_pos_mm=figures,
        sigma_ori_mrad=st.none() | figures,
        chi2_per_dof=st.none() | SIGMA,
    )
    warning = st.builds(DocumentWarning, code=st.just("CODE"), text=WORD)
    return varied(
        replace(template, joints=joints, dh=rows, calibrated=calibrated, quality=quality),
        arm=st.builds(WhichArm, model=WORD, serial=WORD),
        warnings=st.lists(warning, max_size=2).map(tuple),
        software_version=WORD,
        utc=st.datetimes(timezones=st.just(UTC)),
    )


@settings(max_examples=60, deadline=None)
@given(documents())
def test_written_document_is_read_back_bit_for_bit(original):
    assert same(parse_parameters(format_parameters(original)), original)


@pytest.mark.sample(16)
@pytest.mark.parametrize(
    "removed", [k for k, line in enumerate(GOOD.splitlines()) if not line.startswith("#")]
)
def test_missing_line_is_refused(removed):
    lines = GOOD.splitlines(keepends=True)
    shortened = "".join(lines[:removed] + lines[removed + 1 :]).encode()
    with pytest.raises(ConfigError):
        parse_parameters(shortened)


def test_conversion_to_degrees_and_back_changes_at_most_one_bit():
    angles = np.random.default_rng(5).uniform(-np.pi, np.pi, (2, 500))
    table = DhTable(theta_off_rad=angles[0], s_m=angles[0], a_m=angles[1], alpha_rad=angles[1])
    rows = rows_from_table(table)
    read_back = np.deg2rad([row.alpha_deg for row in rows])
    np.testing.assert_array_less(
        np.abs(read_back - angles[1]), 1.01 * np.spacing(np.abs(angles[1]))
    )
    assert [row.a_m for row in rows] == angles[1].tolist()


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


def test_unknown_key_differs_from_misspelt_key():
    unknown, misspelt = parse_problems(parse, GOOD + "thermal: {}\nforcd: no\n")
    assert (unknown.key, unknown.text) == ("thermal", "unknown key")
    assert unknown.remedy.startswith("known here: schema, arm, ")
    assert misspelt.remedy == "did you mean forced?"


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


def test_longest_document_fits_into_a_slot():
    """All joints of a bus, every entry calibrated, sixteen sources in each budget."""
    n = MAX_JOINTS
    names = [f"{kind}_{k}" for kind in ("theta_off", "s", "a", "alpha") for k in range(n + 1)]
    value = 1.0 / 3.0
    rows = tuple(
        DhRow(row=k, theta_off_deg=value, s_m=value, a_m=value, alpha_deg=value)
        for k in range(n + 1)
    )
    factor = np.random.default_rng(4).normal(size=(len(names), len(names)))
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
