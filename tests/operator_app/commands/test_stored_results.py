"""Who shows a journalled calibration solves and judges nothing: the solver is a trap here."""

import shutil

import pytest
import sarcal

from operator_app.calibration.adjudication import adjudicate
from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.cross_validation import check
from operator_app.calibration.rvdt import check_rvdts
from operator_app.calibration.tool_accuracy import tip_sigma
from operator_app.cli import main
from operator_app.session.store.journal import JOURNAL_NAME
from solver.closing import close_loops, newton_step, unsensed_step
from solver.diagnostics.cross_validation import hold_out
from solver.diagnostics.diagnosis import diagnose
from solver.diagnostics.identifiability import identifiability
from solver.diagnostics.statistics import jackknife
from solver.estimators.implicit import estimate_implicit, fit_implicit
from solver.estimators.least_squares import solve_damped
from solver.estimators.mixed_fit import fit_mixed
from solver.estimators.paper import estimate_paper
from solver.estimators.variance_components import estimate_with_errors
from solver.search.global_start import global_start

SOLVING = (
    calibrate, check, close_loops, estimate_implicit, estimate_paper, estimate_with_errors,
    fit_implicit, fit_mixed, global_start, hold_out, identifiability, jackknife, diagnose, check_rvdts,
    newton_step, solve_damped, tip_sigma, unsensed_step, adjudicate,
)  # fmt: skip
MADE = ("run", "paper", "app", "resumed")


def trap(*args: object, **options: object) -> None:
    raise RuntimeError("somebody solves")


@pytest.fixture
def nobody_solves(monkeypatch):
    """Whoever calls one of these, by whatever name it was imported, fails."""
    for function in SOLVING:
        monkeypatch.setattr(function, "__code__", trap.__code__)


@pytest.mark.sample(2)
@pytest.mark.parametrize("made", MADE)
def test_report_and_export_read(made, journalled, nobody_solves, tmp_path, ends_with):
    folder = journalled[made]
    code = 4 if made == "paper" else 0
    ends_with(code, "report", folder, "-o", tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "its solution was read, not made again" in page
    assert "Solved again" not in page
    if made != "paper":
        assert "far block, held out" in page
    found = ends_with(code, "report", folder, "--json").json
    assert found["estimator"] == ("paper" if made == "paper" else "implicit")
    assert found["paper"] is not None
    assert found["session"]["folder"] == str(folder)
    assert "ACCEPTED" in ends_with(code, "report", folder, "--text").out
    ends_with(code, "export", folder, "--force", "a test", "-o", tmp_path / "parameters.yaml")
    assert (tmp_path / "parameters.yaml").is_file()


@pytest.mark.sample(2)
@pytest.mark.parametrize("made", MADE)
def test_python_reads_what_the_command_exports(
    made, journalled, nobody_solves, tmp_path, ends_with
):
    folder, why = journalled[made], "a test"
    read = sarcal.load_result(folder)
    assert read.accepted == (made != "paper")
    options = ["--force", why, "-o", tmp_path / "theirs"]
    for kind in ("json", "csv", "urdf"):
        ends_with(0 if read.accepted else 4, "export", folder, "--format", kind, *options)
        ours = read.export(tmp_path / f"ours.{kind}", force=why)
        assert ours.read_bytes() == (tmp_path / "theirs").read_bytes()
    ends_with(0 if read.accepted else 4, "export", folder, *options)
    ours = read.export(tmp_path / "ours.yaml", force=why)
    said = [
        [line for line in file.read_text().splitlines() if not line.startswith("utc:")]
        for file in (ours, tmp_path / "theirs")
    ]
    assert said[0] == said[1]


@pytest.mark.sample(2)
@pytest.mark.parametrize("made", MADE)
def test_compare_reads_the_journal_and_finds_what_an_export_says(
    made, journalled, nobody_solves, tmp_path, ends_with
):
    alone = tmp_path / "alone"
    alone.mkdir()
    shutil.copy(journalled[made] / JOURNAL_NAME, alone)
    code = 4 if made == "paper" else 0
    ends_with(code, "export", journalled[made], "--force", "a test", "-o", tmp_path / "file.yaml")
    found = ends_with(0, "compare", alone, tmp_path / "file.yaml", "--json").json
    assert set(found["parameters"]) >= {"theta_off_1", "s_0", "alpha_7"}
    # But for the last bit, on the way to degrees and back.
    assert all(abs(p["change"]) < 1e-13 for p in found["parameters"].values())
    # The journal counts, not a file that somebody put beside it.
    (alone / "parameters.yaml").write_text("schema: sarcal/parameters/1\n")
    ends_with(0, "compare", alone, journalled["run" if made == "app" else made])


@pytest.mark.parametrize("options", [("--estimator", "paper"), ("--unsensed", "7")])
def test_the_trap_catches_who_solves(journalled, nobody_solves, options):
    with pytest.raises(RuntimeError, match="somebody solves"):
        main(["report", str(journalled["run"]), "-o", "-", *options])
