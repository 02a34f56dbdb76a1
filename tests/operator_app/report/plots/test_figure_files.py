"""Figures for a paper have the numbers of the JSON object, as SVG and PDF files."""

import sys
import xml.etree.ElementTree as ET
from importlib.resources import files

import numpy as np
import pytest
import sarcal

from operator_app.errors import SessionError
from operator_app.report.plots.figure_files import ENDINGS, FIGURES
from tests.operator_app.report.conftest import at, number
from tests.oracles.panda import FOLDER as PANDA

SVG = "{http://www.w3.org/2000/svg}"


def panels(result: sarcal.Result, name: str) -> list[ET.Element]:
    return ET.fromstring(result.figure(name).svg).findall(f"{SVG}g")  # noqa: S314 - our own output


def of_class(panel: ET.Element, *names: str) -> list[ET.Element]:
    return [e for e in panel.iter() if e.get("class") in names]


def texts(panel: ET.Element) -> list[str]:
    return [e.text or "" for e in panel.iter(f"{SVG}text")]


def scale(panel: ET.Element) -> tuple[float, float]:
    """Slope and value at 0 of a panel's linear x axis, from its ticks as written."""
    ticks = [e for e in of_class(panel, "tick") if e.get("text-anchor") == "middle"]
    values = [number(t.text or "") for t in ticks]
    slope, start = np.polyfit([at(t, "x") for t in ticks], values, 1)
    return float(slope), float(start)


def test_available_figures_depend_on_the_fixture(result, ball):
    assert result.figures == tuple(FIGURES)
    assert set(FIGURES) - set(ball.figures) == {"rvdt", "condition"}
    with pytest.raises(KeyError, match="there are parameters, residuals"):
        result.figure("nothing")


def test_budget_bars_match_the_json(result):
    budget = result.to_json()["budget"]
    (panel,) = panels(result, "budget")
    assert [t for t in texts(panel) if t in budget] == list(budget)
    slope, _ = scale(panel)
    # The first of each is the legend's.
    bars = of_class(panel, *(f"bar b{k}" for k in range(8)))[8:]
    percent = slope * np.array([at(bar, "width") for bar in bars]).reshape(len(budget), 8)
    assert percent.sum(axis=1) == pytest.approx(np.full(len(budget), 100.0), abs=0.5)
    # The largest source comes first.
    sources = list(next(iter(budget.values())))
    by_source = {s: [100.0 * shares[s] for shares in budget.values()] for s in sources}
    assert percent[:, 0] == pytest.approx(max(by_source.values(), key=sum), abs=0.1)


def test_parameter_points_and_intervals_match_the_json(result):
    document = result.to_json()
    names = [n for n in document["parameters"] if n.startswith(("theta", "alpha"))]
    panel = panels(result, "parameters")[0]
    slope, start = scale(panel)
    # The first of each is the legend's.
    points = [slope * at(e, "cx") + start for e in of_class(panel, "mark a")[1:]]
    change = [document["parameters"][n] - document["nominal"][n] for n in names]
    assert points == pytest.approx(change, abs=5e-3)
    bars = of_class(panel, "ribbon")[1:]
    low = [slope * at(e, "x") + start for e in bars]
    width = [slope * at(e, "width") for e in bars]
    ends = np.array([document["interval_95"][n] for n in names])
    expected = ends[:, 0] - [document["nominal"][n] for n in names]
    assert low == pytest.approx(expected, abs=5e-3)
    assert width == pytest.approx(ends[:, 1] - ends[:, 0], abs=5e-3)


def test_residual_and_workspace_panels_match_the_json(result):
    labels = ("position error [mm]", "orientation error [mrad]", "distance [mm]")
    for label, panel in zip(labels, panels(result, "residuals"), strict=True):
        assert label in " ".join(texts(panel))
    radii = [
        max(float(e.get("r", "0")) for e in of_class(p, "mark a")[:-1])
        for p in panels(result, "workspace")
    ]
    worst = result.to_json()["hand_accuracy_mm"]
    expected = np.sqrt(worst["after"]["worst"] / worst["before"]["worst"])
    assert radii[1] / radii[0] == pytest.approx(expected, abs=2e-3)


def test_figure_is_saved_as_standalone_svg(result, tmp_path):
    figure = result.figure("condition")
    assert figure._repr_svg_() == figure.svg
    figure.savefig(tmp_path / "condition.svg")
    assert (tmp_path / "condition.svg").read_text() == figure.svg
    assert "var(" not in figure.svg
    with pytest.raises(ValueError, match=r"\.svg or \.pdf"):
        figure.savefig(tmp_path / "condition.png")


def test_pdf_has_text_and_is_reproducible(result, tmp_path):
    pytest.importorskip("svglib", reason="needs the extra [plots]")
    files = [tmp_path / "one.pdf", tmp_path / "two.pdf"]
    for file in files:
        result.figure("budget").savefig(file)
    one, two = (file.read_bytes() for file in files)
    assert one.startswith(b"%PDF-")
    assert b"/TrueType" in one
    assert one == two


@pytest.mark.campaign
def test_report_command_writes_every_figure(result, tmp_path, run_command):
    pytest.importorskip("svglib", reason="needs the extra [plots]")
    session = result.save(tmp_path / "session")
    page = (session / "report.html").read_bytes()
    figures = tmp_path / "new" / "figures"
    output = run_command(0, "report", session, "--plots", figures).out.splitlines()
    assert output == [f"Figure      {figures}/{n}.{e}" for n in FIGURES for e in ENDINGS]
    assert (session / "report.html").read_bytes() == page
    message = run_command(2, "report", session, "--plots", session / "report.html").err
    assert "cannot be written" in message


def test_without_svglib_only_svg_files_are_written(result, tmp_path, monkeypatch, run_command):
    session = result.save(tmp_path / "session")
    monkeypatch.setitem(sys.modules, "svglib", None)
    monkeypatch.setitem(sys.modules, "svglib.svglib", None)
    with pytest.raises(SessionError, match=r"pip install 'sarcal\[plots\]'"):
        result.figure("budget").savefig(tmp_path / "budget.pdf")
    run_command(0, "report", session, "--plots", tmp_path / "figures")
    assert {file.suffix for file in (tmp_path / "figures").iterdir()} == {".svg"}


def test_parameter_figure_has_stated_sigmas(tmp_path):
    text = (files("operator_app") / "data/arms/franka_panda.yaml").read_text("utf-8")
    arm = tmp_path / "arm.yaml"
    arm.write_text(text.replace("theta_off_7]", "theta_off_7, alpha_3, s_3]"), encoding="utf-8")
    result = sarcal.calibrate(
        arm=arm, fixture="ball", poses=PANDA / "panda_1.csv", drop_unidentifiable=True
    )
    subject = result._subject
    sigmas = FIGURES["parameters"](subject, subject.solution).pictures[1::2]
    stated = {n: s for p in sigmas for n, s in zip(p.names, p.marks["stated before"], strict=True)}
    assert stated["alpha_3"] == pytest.approx(0.2)
    assert stated["s_3"] == pytest.approx(1.0)
    assert stated["theta_off_2"] == pytest.approx(1.0)
