"""The parameters document: what is written is read back bit for bit, and a tampered one is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np
import pytest
import yaml

from operator_app.config.arm_file import load_arm
from operator_app.config.errors import ConfigError
from operator_app.config.fixture_file import load_fixture
from operator_app.config.parameters_file import (
    format_parameters,
    load_parameters,
    parse_parameters,
    save_parameters,
)
from tests.oracles.nominal_document import GOOD, complaint, document


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
    ("schema: sarcal/parameters/2", "schema: sarcal/parameters/4", "schema", "reads version 1 and 2 and 3"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "key", "says"), BAD, ids=[f"{b[2]}: {b[3]}" for b in BAD])
def test_one_mistake_gives_one_complaint(old: str, new: str, key: str, says: str) -> None:
    found = complaint(GOOD, old, new)
    assert [p.key for p in found.problems] == [key], str(found)
    (problem,) = found.problems
    assert says in str(problem)
    assert problem.line is not None


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
