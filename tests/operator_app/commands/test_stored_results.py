"""Commands that show a journalled calibration do not solve: here every solver function fails."""

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
SESSIONS = ("run", "paper", "app", "resumed")


def fail(*args: object, **options: object) -> None:
    raise RuntimeError("the solver was called")


@pytest.fixture
def without_solver(monkeypatch):
    """Every call of these functions fails, by whatever name they were imported."""
    for function in SOLVING:
        monkeypatch.setattr(function, "__code__", fail.__code__)


@pytest.mark.sample(2)
@pytest.mark.parametrize("name", SESSIONS)
def test_report_and_export_do_not_solve(name, journalled, without_solver, tmp_path, run_command):
    folder = journalled[name]
    code = 4 if name == "paper" else 0
    run_command(code, "report", folder, "-o", tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "its solution was read, not made again" in page
    assert "Solved again" not in page
    if name != "paper":
        assert "far block, held out" in page
    report = run_command(code, "report", folder, "--json").json
    assert report["estimator"] == ("paper" if name == "paper" else "implicit")
    assert report["paper"] is not None
    assert report["session"]["folder"] == str(folder)
    assert "ACCEPTED" in run_command(code, "report", folder, "--text").out
    run_command(code, "export", folder, "--force", "a test", "-o", tmp_path / "parameters.yaml")
    assert (tmp_path / "parameters.yaml").is_file()


@pytest.mark.sample(2)
@pytest.mark.parametrize("name", SESSIONS)
def test_python_exports_the_same_files_as_the_command(
    name, journalled, without_solver, tmp_path, run_command
):
    folder, reason = journalled[name], "a test"
    result = sarcal.load_result(folder)
    assert result.accepted == (name != "paper")
    options = ["--force", reason, "-o", tmp_path / "theirs"]
    for kind in ("json", "csv", "urdf"):
        run_command(0 if result.accepted else 4, "export", folder, "--format", kind, *options)
        ours = result.export(tmp_path / f"ours.{kind}", force=reason)
        assert ours.read_bytes() == (tmp_path / "theirs").read_bytes()
    run_command(0 if result.accepted else 4, "export", folder, *options)
    ours = result.export(tmp_path / "ours.yaml", force=reason)
    without_utc = [
        [line for line in file.read_text().splitlines() if not line.startswith("utc:")]
        for file in (ours, tmp_path / "theirs")
    ]
    assert without_utc[0] == without_utc[1]


@pytest.mark.sample(2)
@pytest.mark.parametrize("name", SESSIONS)
def test_compare_reads_the_journal_like_an_export(
    name, journalled, without_solver, tmp_path, run_command
):
    journal_folder = tmp_path / "alone"
    journal_folder.mkdir()
    shutil.copy(journalled[name] / JOURNAL_NAME, journal_folder)
    code = 4 if name == "paper" else 0
    run_command(code, "export", journalled[name], "--force", "a test", "-o", tmp_path / "file.yaml")
    report = run_command(0, "compare", journal_folder, tmp_path / "file.yaml", "--json").json
    assert set(report["parameters"]) >= {"theta_off_1", "s_0", "alpha_7"}
    # Equal up to rounding to degrees and back.
    assert all(abs(p["change"]) < 1e-13 for p in report["parameters"].values())
    # The journal takes precedence over a file beside it.
    (journal_folder / "parameters.yaml").write_text("schema: sarcal/parameters/1\n")
    run_command(0, "compare", journal_folder, journalled["run" if name == "app" else name])


@pytest.mark.parametrize("options", [("--estimator", "paper"), ("--unsensed", "7")])
def test_other_options_call_the_solver(journalled, without_solver, options):
    with pytest.raises(RuntimeError, match="the solver was called"):
        main(["report", str(journalled["run"]), "-o", "-", *options])
