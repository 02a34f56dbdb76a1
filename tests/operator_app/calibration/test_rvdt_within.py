"""A file bounds how far an RVDT's curve strays and says nothing of its shape: within the bound nothing is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from operator_app.calibration.result import Solution
from operator_app.report.facts import facts_of
from operator_app.report.text import facts_text
from solver.diagnostics.rvdt import Soundness
from tests.oracles.as_shipped import solved
from tests.oracles.shop_floor import session
from tests.oracles.shop_floor_faults import CASES
from tests.oracles.shop_floor_misread import rippled


def said(solution: Solution) -> str:
    """The text, without its line breaks."""
    return " ".join(facts_text(facts_of(solution)).split())


@pytest.mark.parametrize("seed", [103, 105])
def test_a_sine_within_its_linearity_is_accepted(seed):
    """NOT ACCEPTED for an RVDT that the same text called within specification."""
    solution = solved(rippled(seed).taken)
    assert all(v.verdict is Soundness.CURVED for v in solution.rvdt)
    assert solution.accepted
    assert not [c for c in solution.causes if c.code.startswith("RVDT")]


def test_what_is_said_of_a_curve_beyond_its_linearity_is_one_figure():
    """The cause had the amplitude as the readings bend it, its notice what the loop measures: 3.2 and 2.7 %."""
    case = CASES["RVDT 3 %"](3001)
    solution = solved(case.taken)
    first = solution.causes[0]
    assert first.code in case.causes
    (verdict,) = (v for v in solution.rvdt if v.verdict is Soundness.OUT_OF_SPECIFICATION)
    assert f"({100.0 * verdict.figures.linearity:.1f} % of full scale" in first.text


def test_a_figure_beyond_the_linearity_by_chance_is_not_called_within_it():
    found = next(v for v in solved(rippled(222).taken).rvdt if v.joint == 7)
    assert found.figures.linearity > 0.02
    assert found.verdict is Soundness.CURVED
    assert "within specification" not in found.text
    assert "not significantly beyond its specification" in found.text
    assert f"(sigma {100.0 * found.figures.linearity_sd:.2f} %, specification 2 %)" in found.text


def test_a_joint_that_moved_in_one_pose_is_named_by_the_pose():
    """An RVDT "out of specification" whose noise "cannot be told", and no pose."""
    found = session(61)
    spread = found.spread.copy()
    spread[4, 5] = np.deg2rad(5.0)
    solution = solved(replace(found, spread=spread))
    assert [c.code for c in solution.causes] == ["UNSTEADY_6"]
    assert (solution.causes[0].poses, solution.causes[0].sensor) == (("p005",), "RVDT")
    verdict = next(v for v in solution.rvdt if v.joint == 6)
    assert verdict.verdict is not Soundness.OUT_OF_SPECIFICATION
    assert verdict.noise.lsb == pytest.approx(2.0, rel=0.1)


def test_what_keeps_the_iteration_from_settling_is_said_before_that_it_did_not():
    """The text had only "the iteration did not settle": the spread was in the JSON."""
    found = session(61)
    spread = found.spread.copy()
    spread[:, 5:] = np.deg2rad(50.0)
    solution = solved(replace(found, spread=spread))
    assert not solution.accepted
    assert [c.code for c in solution.causes] == ["RVDT_6", "RVDT_7", "NOT_CONVERGED"]
    text = said(solution)
    at = [text.index(words) for words in ("RVDT of joint 6", "RVDT of joint 7", "did not converge")]
    assert at == sorted(at)
    assert "(sd6_deg)" in text
