"""Figures in text and JSON; tables in text and HTML."""

import math
from dataclasses import replace

import pytest

from operator_app.report.html.markup import table_html
from operator_app.report.table import Column, FactTable
from operator_app.report.text import table_text
from operator_app.units import ANGLE, LENGTH, NUMBER, Figure

RANGES = FactTable(
    ident="ranges",
    title="Joints",
    columns=(
        Column("joint", words=True),
        Column("angle", unit="deg"),
        Column("low", group="range [deg]"),
        Column("high", group="range [deg]"),
        Column("why", words=True),
        Column("sigma", unit="deg", detail=True),
    ),
    rows=(
        ("1", Figure(0.1, ANGLE, places=2), Figure(-math.pi, ANGLE, places=0),
         Figure(math.pi, ANGLE, places=0, role="warn"), "<b>", Figure(None, ANGLE)),
    ),
    note="As stated.",
    out=frozenset({0}),
)  # fmt: skip


def test_figure_units_unknown_values_and_counts():
    length = Figure(0.2019999, LENGTH, places=3)
    assert (length.shown, length.with_unit, length.in_json) == ("202.000", "202.000 mm", 0.2019999)
    angle = Figure(-math.pi, ANGLE, places=1, signed=True)
    assert (angle.with_unit, angle.in_json) == ("-180.0 deg", -180.0)
    for value, shown in ((None, "n/a"), (math.inf, "infinite"), (math.nan, "n/a")):
        figure = Figure(value, NUMBER, digits=2)
        assert (figure.shown, figure.in_json) == (shown, None)
    count = Figure(14, NUMBER, digits=2)
    assert (count.shown, repr(count.in_json)) == ("14", "14")


def test_html_table_has_scoped_headers(parse_page):
    page = parse_page(table_html(RANGES))
    head, body = page.tables[0]["thead"], page.tables[0]["tbody"]
    assert [(c[1]["scope"], c[2]) for c in head[0]] == [
        ("col", "joint"), ("col", "angle [deg]"), ("colgroup", "range [deg]"), ("col", "why"),
        ("col", "sigma [deg]"),
    ]  # fmt: skip
    assert [(c[1]["scope"], c[2]) for c in head[1]] == [("col", "low"), ("col", "high")]
    assert [cell[2] for cell in body[0]] == ["1", "5.73", "\u2212180", "▲ 180", "<b>", "n/a"]
    assert body[0][0][0] == "th"
    assert body[0][0][1]["scope"] == "row"
    region = {name: value for tag, name, value in page.attributes if tag == "div"}
    assert region["role"] == "region"
    assert region["aria-label"] == "Joints"
    assert region["tabindex"] == "0"
    assert ("tr", "class", "out") in page.attributes


def test_text_table_has_groups_and_no_detail():
    assert table_text(RANGES).splitlines() == [
        "Joints",
        "                      range [deg]",
        "  joint  angle [deg]    low  high  why",
        "  1             5.73   -180   180  <b>",
        "As stated.",
    ]
    with pytest.raises(ValueError, match="one cell per column"):
        replace(RANGES, rows=(("1",),))
