"""Fixture files: packaged placements, and one problem for each mistake."""

import math

import numpy as np
import pytest

from fixtures.ball import Ball, KnownDistance
from fixtures.base import Tolerance
from fixtures.measured import Measured
from operator_app.config.fixture_file import MODELS, load_fixture, parse_fixture
from operator_app.config.resources import resolve
from tests.contracts.planted import FIXTURES
from tests.oracles.mistakes import named, parse_problems, single_problem


def parse(text):
    return parse_fixture(text.encode(), "f.yaml")


GOOD = resolve("fixture", "hinge").data.decode()


def test_packaged_hinge_is_near_table_2_and_stiffness_of_older_files_is_ignored():
    assert parse(GOOD + "stiffness: {n_per_m: 2e6, nm_per_rad: 3e4}\n") == load_fixture("hinge")
    hinge = load_fixture("hinge").fixture
    assert hinge.tolerance == Tolerance(position_m=0.030, orientation_rad=math.radians(10.0))
    lengths_m = (hinge.a_0_m, hinge.s_0_m, hinge.s_1_m, hinge.a_n_m, hinge.s_n_m)
    assert lengths_m == pytest.approx([0.202, 0.014, 0.273, -0.101, 0.038], abs=0.010)
    angles_deg = np.rad2deg([hinge.alpha_0_rad, hinge.alpha_n_rad])
    assert angles_deg == pytest.approx([-38.5, 99.8], abs=2.0)


DISTANCE = "distance: [{between: [1, 2], mm: 50.0, sigma_mm: 0.05}]\n"
BALL = resolve("fixture", "ball").data.decode() + DISTANCE


def test_measured_socket_distances():
    ball = parse(BALL).fixture
    assert isinstance(ball, Ball)
    assert ball.distances == (KnownDistance(between=(1, 2), value_m=0.05, sigma_m=5e-5),)


def test_every_fixture_kind_has_a_file_format():
    assert set(MODELS) == set(FIXTURES)
    for name in ("hinge", "rigid", "ball"):
        spec = load_fixture(name)
        assert spec.kind == name
        assert spec.fixture.kind == name
        assert spec.fixture.compliance.assumed == ()


MEASURED = (
    resolve("fixture", "tracker")
    .data.decode()
    .replace("base_mm: [1500, 0, 0]", "base_mm: [1500, -400, 200]")
    .replace("base_turn_deg: [0, 0, 0]", "base_turn_deg: [10, -20, 120]")
)


def test_measured_fixture_is_read_in_si():
    fixture = parse(MEASURED).fixture
    assert isinstance(fixture, Measured)
    assert fixture.full_pose
    assert fixture.base_m == (1.5, -0.4, 0.2)
    assert fixture.base_turn_rad == pytest.approx(np.deg2rad([10.0, -20.0, 120.0]))
    assert fixture.tip_turn_rad == (0.0, 0.0, 0.0)
    assert fixture.sigma_m == pytest.approx(5e-5)
    assert fixture.sigma_rad == pytest.approx(math.radians(0.02))
    assert not fixture.base_known


BAD_MEASURED = [
    ("measures: pose", "measures: poses", "measures"),
    ("instrument_sigma_deg: 0.02", "instrument_sigma_deg: 0", "instrument_sigma_deg"),
    ("instrument_sigma_deg: 0.02\n", "", "instrument_sigma_deg"),
    ("instrument_sigma_deg: 0.02", "instrument_sigma_dge: 0.02", "instrument_sigma_dge"),
    ("instrument_sigma_deg: 0.02", "instrument_sigma_rad: 5e-5", "instrument_sigma_rad"),
    ("[1500, -400, 200]", "[1500, -400]", "placement.base_mm[3]"),
    ("[1500, -400, 200]", "[1500, -400, 200, 1]", "placement.base_mm"),
    ("[1500, -400, 200]", "[1500, x, 200]", "placement.base_mm[2]"),
    ("[10, -20, 120]", "[0, 0, 3.1416]", "placement.base_turn_deg[3]"),
]

# Old text, new text, key of the problem.
BAD = [
    ("a_0_mm: 200", "a_0_m: -38.5", "placement.a_0_m"),
    ("a_0_mm: 200", "a_0_m: 0.2", "placement.a_0_m"),
    ("a_0_mm: 200", "a_0: 200", "placement.a_0"),
    ("a_n_mm: -100", "a_7_mm: -100", "placement.a_7_mm"),
    ("alpha_0_deg: -40", "alpha_0_rad: -0.7", "placement.alpha_0_rad"),
    ("alpha_0_deg: -40", "alpha_0_deg: 1.5708", "placement.alpha_0_deg"),
    ("alpha_0_deg: -40", "alpha_0_deg: 400", "placement.alpha_0_deg"),
    ("a_0_mm: 200", "a_0_mm: 20200", "placement.a_0_mm"),
    ("  s_1_mm: 270\n", "", "placement.s_1_mm"),
    ("kind: hinge", "kind: henge", "kind"),
    ("kind: hinge\n", "", "kind"),
    ("kind: hinge", "kind: 7", "kind"),
    *(("give: {position_mm: 0.2, orientation_mrad: 0.2}", f"give: {{{name}: {value}}}", f"give.{name}")
      for name, value in (("position_mm", 51), ("position_mm", -1), ("orientation_mrad", 300), ("orientation_deg", 1))),
    ("tolerance_mm: 30", "tolerance_mm: 0", "tolerance_mm"),
    ("tolerance_deg: 10", "tolerance_rad: 0.2", "tolerance_rad"),
    ("name: hinge", "name: 12", "name"),
    ("name: hinge", "name: a b", "name"),
    ("checklist:\n", "checklist: []\nstiffness:\n", "checklist"),
    ("kind: hinge\n", f"kind: hinge\n{DISTANCE}", "distance"),
]  # fmt: skip
BAD_BALL = [
    ("[1, 2]", "[1, 1]", "distance[1].between"),
    ("mm: 50.0", "mm: -50.0", "distance[1].mm"),
    (", sigma_mm: 0.05", ", sigma_mm: 0", "distance[1].sigma_mm"),
    ("0.05}", "0.05}, {between: [2, 1], mm: 51.0, sigma_mm: 0.05}", "distance"),
]


BAD_IN_ANY = [*BAD, *BAD_MEASURED, *BAD_BALL]


@pytest.mark.parametrize(("old", "new", "key"), BAD_IN_ANY, ids=named(BAD_IN_ANY))
def test_one_mistake_gives_one_problem(old, new, key, approve):
    good = next(text for text in (GOOD, MEASURED, BALL) if old in text)
    problem = single_problem(parse, good, old, new)
    assert problem.key == key
    approve(str(problem))


def test_placement_in_metres_gives_one_problem():
    text = GOOD
    for old in ("a_0_mm: 200", "s_0_mm: 10", "s_1_mm: 270", "a_n_mm: -100", "s_n_mm: 40"):
        name, value = old.split(": ")
        text = text.replace(old, f"{name}: {float(value) / 1e3}")
    (problem,) = parse_problems(parse, text)
    assert problem.key == "placement"
    assert "they may be in metres" in problem.text
