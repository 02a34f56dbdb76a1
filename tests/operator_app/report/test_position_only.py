"""A ball's loops give no orientation: null in files, "n/a" in texts."""

import re
from dataclasses import replace

import pytest
import sarcal

from operator_app.config.parameters_file import load_parameters, save_parameters
from operator_app.report.facts import estimate_json, facts_of
from operator_app.report.results.verification import verified_words
from operator_app.report.text import facts_text, table_spans
from tests.oracles.parameter_documents import make_document
from tests.oracles.story import story

UNKNOWN = {"rms": None, "as_printed": None}


@pytest.fixture(scope="module")
def calibrated():
    """A result, and new poses of the same arm."""
    ball = {"arm": "sarcos_dextrous", "fixture": "sarcos_ball"}
    q_rad = sarcal.simulate(**ball, poses=30, seed=1).poses.q_rad
    made_from, new = sarcal.poses_of(q_rad=q_rad[:22]), sarcal.poses_of(q_rad=q_rad[22:])
    return sarcal.calibrate(**ball, poses=made_from, drop_unidentifiable=True), new


def test_json_has_null_orientation(calibrated):
    solution = calibrated[0]._subject.solution
    document = facts_of(solution).json
    for part in (document, document["before"], estimate_json(solution.paper)):
        assert part["sigma_ori_mrad"] == UNKNOWN
        assert part["sigma_pos_mm"]["rms"] > 0.0


def test_text_and_screen_show_no_orientation(calibrated):
    facts = facts_of(calibrated[0]._subject.solution)
    table = facts.table("closure")
    _, body = table_spans(table)
    screen = ["".join(words for words, _ in spans) for spans in body]
    for lines in (facts_text(facts).splitlines(), screen):
        rows = [line for line in lines if re.search(r"before|after|comparison", line)]
        closures = [line for line in rows if "n/a" in line]
        assert len(closures) == len(table.rows)
        assert all(line.count("n/a") == 2 for line in closures)


def test_verification_uses_positions_only(calibrated):
    verification = sarcal.verify(*calibrated)
    rows = [
        line for line in str(verification).splitlines() if line.lstrip().startswith("calibrated")
    ]
    assert [row.split()[-2:] for row in rows] == 3 * [["n/a", "n/a"]]
    data = verification.to_json()
    assert data["with_best_table"]["sigma_pos_mm"]["rms"] > 0.0
    assert data["with_corrections"]["sigma_ori_mrad"] == UNKNOWN
    assert re.search(r": [\d.]+ mm rms, chi2", verified_words(verification._result))
    hinge = story()["verified"].verification
    assert re.search(r": [\d.]+ mm, [\d.]+ mrad rms, chi2", verified_words(hinge))
    assert data["sigma_ori_mrad"] == data["nominal"]["sigma_ori_mrad"] == UNKNOWN


def test_parameters_file_keeps_null_orientation(tmp_path):
    hinge = make_document()
    document = replace(hinge, quality=replace(hinge.quality, sigma_ori_mrad=None))
    save_parameters(tmp_path / "parameters.yaml", document)
    assert "sigma_ori_mrad: null" in (tmp_path / "parameters.yaml").read_text()
    assert load_parameters(tmp_path / "parameters.yaml") == document
