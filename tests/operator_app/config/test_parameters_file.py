"""Parameters document: written and read back bit for bit; a modified one is refused."""

import math
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from operator_app.config.arm_file import load_arm
from operator_app.config.errors import ConfigError
from operator_app.config.fixture_file import load_fixture
from operator_app.config.parameter_records import (
    CalibratedEntry,
    DocumentWarning,
    JointParameters,
    TwoFigures,
    WhichArm,
)
from operator_app.config.parameters_file import (
    format_parameters,
    load_parameters,
    parse_parameters,
    rows_from_table,
    save_parameters,
)
from solver.chain.kinematics import DhTable
from tests.oracles.identity import same
from tests.oracles.mistakes import named, single_problem
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

    def test_saved_document_is_loaded(self, tmp_path):
        save_parameters(tmp_path / "p.yaml", document())
        assert load_parameters(tmp_path / "p.yaml") == document()
        with pytest.raises(ConfigError, match="no such file"):
            load_parameters(tmp_path / "none.yaml")


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
    ("0123456789abcdef0123", "XYZ3456789abcdef0123", "pose_set_sha256"),
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


@pytest.mark.parametrize(("old", "new", "key"), BAD, ids=named(BAD))
def test_one_mistake_gives_one_problem(old, new, key, approve):
    problem = single_problem(parse, GOOD, old, new)
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


@pytest.mark.parametrize("zone", [None, timezone(timedelta(hours=1))])
def test_document_needs_all_rows_and_utc(zone):
    with pytest.raises(ValueError, match="rows 0 to n"):
        replace(document(), dh=document().dh[1:])
    with pytest.raises(ValueError, match="UTC"):
        replace(document(), utc=datetime(2026, 1, 1, tzinfo=zone))


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
    rng = np.random.default_rng(5)
    angles = rng.uniform(-np.pi, np.pi, (2, 500))
    table = DhTable(theta_off_rad=angles[0], s_m=angles[0], a_m=angles[1], alpha_rad=angles[1])
    rows = rows_from_table(table)
    read_back = np.deg2rad([row.alpha_deg for row in rows])
    np.testing.assert_array_less(
        np.abs(read_back - angles[1]), 1.01 * np.spacing(np.abs(angles[1]))
    )
    assert [row.a_m for row in rows] == angles[1].tolist()
