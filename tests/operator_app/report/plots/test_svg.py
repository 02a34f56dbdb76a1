"""SVG plots: well-formed, named, with round ticks, and values in their places."""

import math
import xml.etree.ElementTree as ET

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from operator_app.report.plots.plot import Band, Marks, Picture, Polyline, axis
from operator_app.report.plots.svg import plot
from tests.operator_app.report.conftest import at

NUMBERS = st.floats(-1e9, 1e9, allow_nan=False).filter(lambda v: v == 0.0 or abs(v) > 1e-9)


@given(st.lists(NUMBERS, max_size=12), st.booleans())
@example([199164480.0, 176843063.0], False)
def test_axis_covers_its_values_with_round_ticks(values, symmetric):
    result = axis("x", values, unit="mm", symmetric=symmetric)
    assert result.low < result.high
    assert all(result.low <= v <= result.high for v in values)
    assert 2 <= len(result.ticks) <= 8
    assert all(result.low <= t <= result.high + 1e-9 * abs(result.high) for t in result.ticks)
    step = result.ticks[1] - result.ticks[0]
    assert f"{step:.3e}"[0] in "125"
    assert len(set(result.tick_texts)) == len(result.ticks)


def test_tick_texts():
    assert axis("pose", [1.0, 2.0, 3.0], whole=True).tick_texts == ("1", "2", "3")
    assert axis("pose", [7.0], whole=True).tick_texts == ("7",)
    assert axis("x", [0.0, 1.0]).tick_texts == ("0.0", "0.5", "1.0")
    assert axis("x", [math.nan]).low < 1.0


def parse(drawn: str) -> ET.Element:
    return ET.fromstring(drawn)  # noqa: S314 - our own output


def example_plot(**changes: object) -> ET.Element:
    settings: dict[str, object] = {
        "ident": "p",
        "title": "Title <1>",
        "description": "What it shows",
        "x": axis("pose", [1.0, 3.0], whole=True),
        "y": axis("error", [-2.0, 2.0], unit="mm"),
        "layers": [
            Band(low=-1.0, high=1.0, label="rms"),
            Polyline(x=[1.0, 3.0], y=[-2.0, 2.0], label="fit"),
            Marks(x=[1.0, 2.0, 3.0], y=[-2.0, math.nan, 2.0], label="x", tips=["a", "b", "<c>"]),
        ],
    }
    return parse(plot(Picture(**(settings | changes))))  # type: ignore[arg-type]


def test_plot_has_title_and_description():
    svg = example_plot()
    assert svg.get("role") == "img"
    named = [svg.find(tag) for tag in ("title", "desc")]
    assert [part.text for part in named if part is not None] == ["Title <1>", "What it shows"]
    assert svg.get("aria-labelledby") == "p-t p-d"
    assert [part.get("id") for part in named if part is not None] == ["p-t", "p-d"]
    words = [part.text for part in svg.iter("text")]
    assert "error [mm]" in words
    assert "pose" in words
    assert {"rms", "fit", "x"} <= set(words)


def test_marks_are_at_their_tick_positions():
    svg = example_plot()
    marks = [c for c in svg.iter("circle") if c.find("title") is not None]
    assert [m.findtext("title") for m in marks] == ["a", "<c>"]
    lines = [e for e in svg.iter("line") if e.get("class") in ("grid", "zero")]
    labels = [e.text for e in svg.iter("text") if e.get("text-anchor") == "end"]
    y_of = {label: at(line, "y1") for line, label in zip(lines, labels, strict=False)}
    assert at(marks[0], "cy") == pytest.approx(y_of["\u22122"], abs=0.02)
    assert at(marks[1], "cy") == pytest.approx(y_of["2"], abs=0.02)
    band = next(e for e in svg.iter("rect") if at(e, "width") > 100.0)
    assert at(band, "y") == pytest.approx(y_of["1"], abs=0.02)
    assert at(band, "height") == pytest.approx(y_of["\u22121"] - y_of["1"], abs=0.03)


def test_band_is_clipped_to_the_frame():
    svg = example_plot(layers=[Band(low=-50.0, high=50.0)])
    band = next(svg.iter("rect"))
    frame = next(e for e in svg.iter("line") if e.get("class") == "frame")
    assert at(band, "y") >= 0.0
    assert at(band, "y") + at(band, "height") == pytest.approx(at(frame, "y1"), abs=0.02)
