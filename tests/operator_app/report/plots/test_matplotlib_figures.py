"""Figures for a paper hold the numbers of the JSON object, and the files are what their endings say."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sarcal

from operator_app.cli import main
from operator_app.errors import SessionError
from operator_app.report.plots.matplotlib_figures import symbol
from operator_app.report.plots.paper_figures import FIGURES
from tests.oracles.panda import FOLDER as PANDA

HINGE = Path(__file__).parents[3] / "data/hinge/hinge_quantised.csv"


@pytest.fixture(scope="module")
def hinge() -> sarcal.Result:
    return sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=HINGE)


@pytest.fixture
def mpl() -> Any:
    return pytest.importorskip("matplotlib", reason="needs the extra [plots]")


def test_a_hinge_has_them_all_and_a_ball_what_it_has(hinge: sarcal.Result) -> None:
    assert hinge.figures == tuple(FIGURES)
    ball = sarcal.calibrate(
        arm="franka_panda", fixture="ball", poses=PANDA / "panda_1.csv", drop_unidentifiable=True
    )
    # Six sockets, no RVDT, and what several placements have no trend of.
    assert set(FIGURES) - set(ball.figures) == {"rvdt", "condition"}


def test_bars_are_the_shares_of_the_budget(hinge: sarcal.Result, mpl: Any) -> None:
    budget = hinge.to_json()["budget"]
    (ax,) = hinge.figure("budget").axes
    names = [text.get_text() for text in ax.get_yticklabels()]
    assert names == [symbol(name) for name in budget]
    bars = {c.get_label(): [bar.get_width() for bar in c] for c in ax.containers}
    assert bars["fixture give"] == pytest.approx([s["fixture_give"] * 100 for s in budget.values()])
    gains = [100 * (s["rvdt_gain_6"] + s["rvdt_gain_7"]) for s in budget.values()]
    others = {label: widths for label, widths in bars.items() if label != "all others"}
    assert len(others) == 7
    assert bars.get("RVDT gain", gains) == pytest.approx(gains)
    assert np.sum(list(bars.values()), axis=0) == pytest.approx(np.full(len(budget), 100.0), abs=1)


def test_points_and_intervals_are_those_of_the_result(hinge: sarcal.Result, mpl: Any) -> None:
    said = hinge.to_json()
    upper, _, lower, _ = hinge.figure("parameters").axes
    names = [n for n in said["parameters"] if n.startswith(("theta", "alpha"))]
    (points, _, (bars,)) = upper.containers[0]
    change = [said["parameters"][n] - said["nominal"][n] for n in names]
    assert points.get_ydata() == pytest.approx(change, abs=1e-9)
    ends = np.array([[p[1] for p in segment] for segment in bars.get_segments()])
    wanted = [[end - said["nominal"][n] for end in said["interval_95"][n]] for n in names]
    assert np.sort(ends, axis=1) == pytest.approx(np.array(wanted), abs=1e-9)
    sigmas = {line.get_label(): line.get_ydata() for line in lower.get_lines()}
    assert sigmas["all stated sources"] == pytest.approx([said["sigma"][n] for n in names])
    # The fixture's file: its angles within 10 deg; of the arm's offsets nobody states anything.
    before = dict(zip(names, sigmas["before: as the files state"], strict=True))
    assert before["alpha_0"] == pytest.approx(10.0)
    assert np.isnan(before["theta_off_3"])


def test_marks_are_the_residuals_and_areas_the_hands_errors(hinge: sarcal.Result, mpl: Any) -> None:
    shown = hinge.figure("residuals").axes
    assert [ax.get_ylabel() for ax in shown] == [
        "position error [mm]", "orientation error [mrad]", "distance [mm]",
    ]  # fmt: skip
    rms = hinge.to_json()["sigma_pos_mm"]["rms"]
    per_axis = [c.get_offsets()[:, 1] for c in shown[0].collections]
    assert np.sqrt(np.mean(np.square(per_axis))) == pytest.approx(rms)
    before, after = hinge.figure("workspace").axes
    worst = hinge.to_json()["hand_accuracy_mm"]
    areas = [ax.collections[0].get_sizes().max() for ax in (before, after)]
    assert areas[1] / areas[0] == pytest.approx(worst["after"]["worst"] / worst["before"]["worst"])
    with pytest.raises(KeyError, match="there are parameters, residuals"):
        hinge.figure("nothing")


def test_a_figure_is_shown_in_a_notebook_and_saved_with_its_text(
    hinge: sarcal.Result, tmp_path: Path, mpl: Any
) -> None:
    made = hinge.figure("condition")
    assert isinstance(made, mpl.figure.Figure)
    assert made._repr_png_().startswith(b"\x89PNG")
    made.axes[0].set_title("Fig. 3")
    made.savefig(tmp_path / "condition.pdf")
    pdf = (tmp_path / "condition.pdf").read_bytes()
    assert b"/Type3" not in pdf


def test_symbols_are_the_papers() -> None:
    assert symbol("alpha_0") == r"$\alpha_{0}$"
    assert symbol("theta_off_1[2]") == r"$\theta^{\mathrm{off}}_{1,2}$"
    assert symbol("ground_x[3]") == "ground_x[3]"


@pytest.mark.campaign
def test_the_command_writes_every_figure_twice(
    hinge: sarcal.Result, tmp_path: Path, capsys: pytest.CaptureFixture[str], mpl: Any
) -> None:
    session = hinge.save(tmp_path / "session")
    page = (session / "report.html").read_bytes()
    there = tmp_path / "new" / "figures"
    assert main(["report", str(session), "--plots", str(there)]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said == [f"Figure      {there}/{n}.{e}" for n in FIGURES for e in ("pdf", "png")]
    for name in FIGURES:
        assert (there / f"{name}.pdf").read_bytes().startswith(b"%PDF-")
        assert (there / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    # Text as text, no time of day.
    pdf = (there / "condition.pdf").read_bytes()
    assert b"/TrueType" in pdf or b"/CIDFontType2" in pdf
    assert b"/Type3" not in pdf
    assert b"CreationDate" not in pdf
    assert (session / "report.html").read_bytes() == page
    assert main(["report", str(session), "--plots", str(session / "report.html")]) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_without_matplotlib_the_remedy_is_said(
    hinge: sarcal.Result,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    session = hinge.save(tmp_path / "session")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(SessionError, match=r"pip install 'sarcal\[plots\]'"):
        hinge.figure("budget")
    assert main(["report", str(session), "--plots", str(tmp_path / "figures")]) == 2
    said = "sarcal: figures for a paper need matplotlib, which is not installed. "
    assert capsys.readouterr().err == f"{said}pip install 'sarcal[plots]'.\n"
