"""The parameters document: what is written is read back bit for bit, and a tampered one is refused."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.objects import MAX_JOINTS
from hardware.virtual.sdo_server import LONGEST_DOCUMENT
from operator_app.config.arm_file import load_arm
from operator_app.config.errors import ConfigError
from operator_app.config.fixture_file import load_fixture
from operator_app.config.parameter_records import (
    CalibratedEntry,
    Correction,
    DhRow,
    DocumentWarning,
    JointParameters,
    Quality,
    RvdtRemedy,
    Side,
    TwoFigures,
    WhichArm,
    WhichFixture,
)
from operator_app.config.parameter_uncertainty import budget_of, correlations_of
from operator_app.config.parameters import ParametersDocument
from operator_app.config.parameters_file import (
    format_parameters,
    load_parameters,
    parse_parameters,
    save_parameters,
)
from operator_app.config.parameters_from_table import joints_from_table, rows_from_table
from solver.chain.kinematics import DhTable


def document() -> ParametersDocument:
    arm = load_arm("sarcos_dextrous")
    loop = load_fixture("hinge").fixture.model(arm)
    calibrated = tuple(
        CalibratedEntry.of(entry.name, 0.001 * (k + 1)) for k, entry in enumerate(loop.entries)
    )
    return ParametersDocument(
        arm=WhichArm(model=arm.name, serial="SDA-0007"),
        joints=joints_from_table(arm, loop.table, calibrated),
        dh=rows_from_table(loop.table),
        calibrated=calibrated,
        fixture=WhichFixture(name="hinge", kind="hinge"),
        quality=Quality(
            poses=40,
            rank=14,
            scaled_condition_number=33.1,
            sigma_pos_mm=TwoFigures(rms=2.7, as_printed=0.1),
            sigma_ori_mrad=TwoFigures(rms=6.6, as_printed=0.3),
            chi2_per_dof=None,
        ),
        warnings=(DocumentWarning(code="RVDT_LINEARITY", text="joint 6: 2 % of full scale"),),
        estimator="paper",
        pose_set_sha256="0123456789abcdef" * 4,
        software_version="0.1.0",
        utc=datetime(2026, 1, 31, 12, 0, 0, 250000, tzinfo=UTC),
    )


GOOD = format_parameters(document()).decode()


class TestContent:
    def test_reads_back_the_same(self) -> None:
        assert parse_parameters(GOOD.encode()) == document()

    def test_an_ordinary_yaml_reader_sees_the_same_numbers(self) -> None:
        data = yaml.safe_load(GOOD)
        assert next(iter(data)) == "schema"
        assert data["arm"] == {"model": "sarcos_dextrous", "serial": "SDA-0007"}
        assert [row["row"] for row in data["dh"]] == list(range(8))
        assert data["dh"][3]["s_m"] == 0.355
        assert data["dh"][0] == {
            "row": 0, "theta_off_deg": 0.0, "s_m": 0.01, "a_m": 0.2, "alpha_deg": -40.0,
        }  # fmt: skip
        assert [j["theta_off_deg"] for j in data["joints"]] == [10, -120, -20, -10, 30, 120, 90]

    def test_home_offsets_are_whole_counts_of_each_sensor(self) -> None:
        counts = [joint.home_offset_counts for joint in document().joints]
        encoder = [round(deg / 360.0 * 400000) for deg in (10, -120, -20, -10, 30)]
        rvdt = [round(deg / 120.0 * 4096) for deg in (120, 90)]
        assert counts == encoder + rvdt

    def test_the_table_is_the_loop_s_in_si(self) -> None:
        table = load_fixture("hinge").fixture.model(load_arm("sarcos_dextrous")).table
        np.testing.assert_array_equal(document().table.stacked(), table.stacked())
        np.testing.assert_array_equal(document().theta_off_rad, table.theta_off_rad[1:])

    def test_saved_and_loaded(self, tmp_path: Path) -> None:
        save_parameters(tmp_path / "p.yaml", document())
        assert load_parameters(tmp_path / "p.yaml") == document()
        with pytest.raises(ConfigError, match="no such file"):
            load_parameters(tmp_path / "none.yaml")


FLOAT = st.floats(-360.0, 360.0)
LENGTH = st.floats(-10.0, 10.0)
SIGMA = st.floats(0.0, 1e6)
WORD = st.text(min_size=1, max_size=20, alphabet=st.characters(exclude_categories=("Cs",)))


@st.composite
def documents(draw: st.DrawFn) -> ParametersDocument:
    n = draw(st.integers(1, 8))
    rows = tuple(
        DhRow(
            row=k,
            theta_off_deg=draw(FLOAT),
            s_m=draw(LENGTH),
            a_m=draw(LENGTH),
            alpha_deg=draw(FLOAT),
        )
        for k in range(n + 1)
    )
    names = [f"{kind}_{k}" for kind in ("theta_off", "s", "a", "alpha") for k in range(n + 1)]
    chosen = draw(st.lists(st.sampled_from(names), unique=True))
    calibrated = tuple(CalibratedEntry.of(name, draw(SIGMA)) for name in chosen)
    sigma = {item.entry: item.sigma for item in calibrated}
    figures = st.builds(TwoFigures, rms=SIGMA, as_printed=SIGMA)
    return ParametersDocument(
        arm=WhichArm(model=draw(WORD), serial=draw(WORD)),
        joints=tuple(
            JointParameters(
                joint=k,
                theta_off_deg=rows[k].theta_off_deg,
                sigma_deg=sigma.get(f"theta_off_{k}"),
                home_offset_counts=draw(st.none() | st.integers(-(2**31), 2**31 - 1)),
            )
            for k in range(1, n + 1)
        ),
        dh=rows,
        calibrated=calibrated,
        fixture=WhichFixture(name=draw(WORD), kind=draw(WORD)),
        quality=Quality(
            poses=draw(st.integers(1, 10**6)),
            rank=draw(st.integers(0, len(chosen))),
            scaled_condition_number=draw(st.floats(1.0, 1e300)),
            sigma_pos_mm=draw(figures),
            sigma_ori_mrad=draw(figures),
            chi2_per_dof=draw(st.none() | SIGMA),
        ),
        warnings=tuple(
            DocumentWarning(code="CODE", text=text) for text in draw(st.lists(WORD, max_size=2))
        ),
        estimator=draw(st.sampled_from(["paper", "implicit"])),
        pose_set_sha256=draw(st.text("0123456789abcdef", min_size=64, max_size=64)),
        software_version=draw(WORD),
        utc=draw(st.datetimes(timezones=st.just(UTC))),
    )


def bits(value: Any) -> Iterator[Any]:
    """All leaves of a document, floats as their 64 bits."""
    if is_dataclass(value):
        for field in fields(value):
            yield from bits(getattr(value, field.name))
    elif isinstance(value, tuple):
        for item in value:
            yield from bits(item)
    else:
        yield struct.pack("d", value) if isinstance(value, float) else value


@settings(max_examples=60, deadline=None)
@given(documents())
def test_writing_and_reading_changes_no_bit(original: ParametersDocument) -> None:
    again = parse_parameters(format_parameters(original))
    assert list(bits(again)) == list(bits(original))


# Old text, new text; the key of the one complaint; what it says.
BAD = [
    ("a_m: 0.2,", "a_m: -38.5,", "dh[row 0].a_m", "degrees where metres belong?"),
    ("a_m: 0.2,", "a_mm: 200,", "dh[row 0].a_mm", "wants metres, not millimetres: write a_m"),
    ("a_m: 0.2,", "a_m: .nan,", "dh[row 0].a_m", "not a finite number"),
    ("a_m: 0.2,", "a_m: 0.2, a_m: 0.3,", "dh[row 0].a_m", "given twice"),
    ("a_m: 0.2,", "", "dh[row 0].a_m", "is missing"),
    ("{joint: 1, theta_off_deg: 10.0", "{joint: 1, theta_off_deg: 10.5", "dh[row 1].theta_off_deg",
     "changed in one place only"),
    ("{joint: 1, theta_off_deg: 10.0", "{joint: 1, theta_off_deg: 400", "joints[joint 1].theta_off_deg",
     "more than a turn"),
    ("sigma_deg: 0.001,", "sigma_deg: -0.001,", "joints[joint 1].sigma_deg", "at least 0"),
    ("sigma_deg: 0.001,", "sigma_deg: 0.002,", "calibrated[theta_off_1]", "0.001 is not the 0.002"),
    ("{entry: theta_off_1, sigma_deg: 0.001}", "{entry: theta_off_1, sigma_m: 0.001}",
     "calibrated[theta_off_1]", "write sigma_deg"),
    ("entry: a_0", "entry: b_0", "calibrated[b_0].entry", "not a D-H entry"),
    ("entry: a_0", "entry: a_9", "calibrated[a_9]", "no row 9"),
    ("entry: a_0", "entry: s_0", "calibrated[s_0]", "listed twice"),
    ("home_offset_counts: 11111}", "home_offset_counts: 11111.5}",
     "joints[joint 1].home_offset_counts", "whole number"),
    ("home_offset_counts: 11111}", "home_offset_counts: 3000000000}",
     "joints[joint 1].home_offset_counts", "at most"),
    ("joint: 2,", "joint: 3,", "joints[joint 3].joint", "joint 2 belongs"),
    ("row: 2,", "row: 3,", "dh[row 3].row", "row 2 belongs"),
    ("estimator: paper", "estimator: best", "estimator", "one of: paper, implicit"),
    ("12:00:00.250000Z", "12:00:00+01:00", "utc", "no UTC time"),
    ("2026-01-31", "2026-02-31", "utc", "no UTC time"),
    ("0123456789abcdef0123", "XYZ3456789abcdef0123", "pose_set_sha256", "right form"),
    ("serial: SDA-0007", "serial: ''", "arm.serial", "is empty"),
    ("serial: SDA-0007", "serial: 7", "arm.serial", "must be text"),
    ("rank: 14", "rank: 15", "quality.rank", "rank 15 for 14 calibrated entries"),
    ("rank: 14", "rank: 14\n  grade: A", "quality.grade", "unknown key"),
    ("scaled_condition_number: 33.1", "scaled_condition_number: .inf",
     "quality.scaled_condition_number", "not a finite number"),
    ("code: RVDT_LINEARITY", "code: r v", "warnings[1].code", "right form"),
    ("schema: sarcal/parameters/2", "schema: sarcal/arm/1", "schema", "this is a file of kind arm"),
    ("schema: sarcal/parameters/2", "schema: sarcal/parameters/3", "schema", "reads version 1 and 2"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "key", "says"), BAD, ids=[f"{b[2]}: {b[3]}" for b in BAD])
def test_one_mistake_gives_one_complaint(old: str, new: str, key: str, says: str) -> None:
    assert old in GOOD
    with pytest.raises(ConfigError) as caught:
        parse_parameters(GOOD.replace(old, new, 1).encode())
    assert [p.key for p in caught.value.problems] == [key], str(caught.value)
    (problem,) = caught.value.problems
    assert says in str(problem)
    assert problem.line is not None


def test_version_1_is_still_read_and_has_neither_side_nor_correction() -> None:
    found = parse_parameters(GOOD.replace("sarcal/parameters/2", "sarcal/parameters/1", 1).encode())
    assert found == document()
    assert {entry.side for entry in found.calibrated} == {None}
    assert found.rvdt == ()
    assert (found.correlations, found.budget) == ({}, {})


def with_a_remedy() -> ParametersDocument:
    rows = ((-260.0, 0.1, 0.01), (-230.5, 1.0 / 3.0, 0.01), (-200.0, -0.2, 0.02))
    table = tuple(Correction(reading_deg=r, add_deg=a, sigma_deg=s) for r, a, s in rows)
    remedy = RvdtRemedy(joint=6, theta_off_deg=116.3, gain=0.98, table=table)
    sides: tuple[Side, ...] = ("arm", "ground", "hand")
    listed = tuple(
        replace(entry, side=sides[k % 3]) for k, entry in enumerate(document().calibrated)
    )
    return replace(document(), rvdt=(remedy,), calibrated=listed, forced="the wrist is new")


def test_what_version_2_brings_reads_back_the_same() -> None:
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
    ("old", "new", "key", "says"),
    [
        ("reading_deg: -230.5", "reading_deg: -270.5", "rvdt[joint 6].table", "from the lowest to the highest"),
        ("joint: 6\n", "joint: 8\n", "rvdt[joint 8].joint", "there is no joint 8"),
        ("gain: 0.98", "gain: 0", "rvdt[joint 6].gain", "greater than 0"),
        ("side: ground", "side: table", "calibrated[theta_off_2].side", "arm, ground, hand"),
    ],
)  # fmt: skip
def test_one_mistake_in_a_remedy_gives_one_complaint(
    old: str, new: str, key: str, says: str
) -> None:
    good = format_parameters(with_a_remedy()).decode()
    assert old in good
    with pytest.raises(ConfigError) as caught:
        parse_parameters(good.replace(old, new, 1).encode())
    assert [p.key for p in caught.value.problems] == [key], str(caught.value)
    assert says in str(caught.value)


def with_correlations() -> ParametersDocument:
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


def test_correlations_and_budget_read_back_the_same() -> None:
    written = format_parameters(with_correlations())
    assert parse_parameters(written) == with_correlations()
    data = yaml.safe_load(written)
    assert list(data["correlations"]) == [e["entry"] for e in data["calibrated"]][1:]
    assert [len(row) for row in data["correlations"].values()] == list(range(1, 14))
    assert data["budget"]["theta_off_1"] == {"lengths": 0.25, "fixture_give": 0.75}


def test_a_parameter_without_variance_goes_with_none_and_has_no_budget() -> None:
    covariance = np.diag([4.0, 0.0, 1.0])
    covariance[0, 2] = covariance[2, 0] = -1.0
    assert correlations_of(("a", "b", "c"), covariance) == {"b": (0.0,), "c": (-0.5, 0.0)}
    parts = {"lengths": np.array([1.0, 0.0, 1.0]), "sag": np.array([3.0, 0.0, 0.0])}
    assert budget_of(("a", "b", "c"), np.diagonal(covariance), parts) == {
        "a": {"lengths": 0.25, "sag": 0.75},
        "c": {"lengths": 1.0},
    }


@pytest.mark.parametrize(
    ("old", "new", "key", "says"),
    [
        ("  theta_off_3: [", "  theta_off_3: [0.5, ", "correlations.theta_off_3", "has 3 correlations, 2 entries"),
        ("  theta_off_3: [", "  theta_off_9: [", "correlations", "after the first, in their order"),
        ("  theta_off_3: [", "  theta_off_3: [1", "correlations.theta_off_3[1]", "at most 1"),
        ("{lengths: 0.25,", "{lengths: 1.25,", "budget.theta_off_1.lengths", "at most 1"),
        ("{lengths: 0.25,", "{lengths: 0.2,", "budget.theta_off_1", "add up to 0.95, not 1"),
        ("  theta_off_1: {lengths", "  theta_off_8: {lengths", "budget.theta_off_8", "not listed as calibrated"),
    ],
)  # fmt: skip
def test_one_mistake_in_them_gives_one_complaint(old: str, new: str, key: str, says: str) -> None:
    good = format_parameters(with_correlations()).decode()
    assert old in good
    with pytest.raises(ConfigError) as caught:
        parse_parameters(good.replace(old, new, 1).encode())
    assert [p.key for p in caught.value.problems] == [key], str(caught.value)
    assert says in str(caught.value)
    assert caught.value.problems[0].line is not None


def test_the_longest_document_there_can_be_fits_into_a_slot() -> None:
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


@pytest.mark.parametrize(
    "missing", [k for k, line in enumerate(GOOD.splitlines()) if not line.startswith("#")]
)
def test_any_line_that_is_cut_out_is_noticed(missing: int) -> None:
    lines = GOOD.splitlines(keepends=True)
    cut = "".join(lines[:missing] + lines[missing + 1 :]).encode()
    with pytest.raises(ConfigError):
        parse_parameters(cut)


def outcome(data: bytes) -> ParametersDocument | ConfigError:
    try:
        return parse_parameters(data)
    except ConfigError as error:
        return error


@settings(max_examples=120, deadline=None)
@given(st.data())
def test_a_damaged_document_is_refused_in_words(data: st.DataObject) -> None:
    start = data.draw(st.integers(0, len(GOOD) - 1))
    end = data.draw(st.integers(start, min(len(GOOD), start + 30)))
    put = data.draw(st.text(alphabet=":,{}[]-#\n \t\"'01.eab\0", max_size=6))
    found = outcome((GOOD[:start] + put + GOOD[end:]).encode())
    if isinstance(found, ConfigError):
        assert all(problem.text for problem in found.problems)
    else:
        assert len(found.dh) == len(found.joints) + 1


class TestResultsThatCannotBeWritten:
    def test_numbers_that_are_not_finite(self) -> None:
        quality = replace(document().quality, scaled_condition_number=math.inf)
        with pytest.raises(ConfigError, match="the result: inf cannot be written") as caught:
            format_parameters(replace(document(), quality=quality))
        assert len(caught.value.problems) == 1

    def test_an_iteration_that_ran_away(self) -> None:
        rows = (replace(document().dh[0], a_m=1e6), *document().dh[1:])
        with pytest.raises(
            ConfigError, match=r"^the result: dh\[row 0\]\.a_m: .*cannot be exported"
        ):
            format_parameters(replace(document(), dh=rows))


class TestWrongCalls:
    def test_rows_and_joints(self) -> None:
        with pytest.raises(ValueError, match="rows 0 to n"):
            replace(document(), dh=document().dh[1:])

    @pytest.mark.parametrize("zone", [None, timezone(timedelta(hours=1))])
    def test_local_time(self, zone: timezone | None) -> None:
        with pytest.raises(ValueError, match="UTC"):
            replace(document(), utc=datetime(2026, 1, 1, tzinfo=zone))


def test_any_table_in_radians_survives_the_document_to_the_last_bit_or_the_next() -> None:
    """Degrees are not as dense as radians everywhere; where they are, nothing changes."""
    rng = np.random.default_rng(5)
    angles = rng.uniform(-np.pi, np.pi, (2, 500))
    table = DhTable(theta_off_rad=angles[0], s_m=angles[0], a_m=angles[1], alpha_rad=angles[1])
    rows = rows_from_table(table)
    back = np.deg2rad([row.alpha_deg for row in rows])
    np.testing.assert_array_less(np.abs(back - angles[1]), 1.01 * np.spacing(np.abs(angles[1])))
    assert [row.a_m for row in rows] == angles[1].tolist()
