"""A braille plot: numbers beside the axis are in the row of their value."""

import pytest

from operator_app.report.plots.plot import Marks, Picture, axis
from operator_app.tui.widgets.pictures import LABEL, plot

WIDTH = 60


def rows_of(values: list[float], drawn: float, height: int) -> list[tuple[str, str]]:
    """Text beside the axis and the plot right of it, by row, with one mark at the value `drawn`."""
    picture = Picture(
        ident="p", title="p", description="", x=axis("x", [1.0, 2.0, 3.0]), y=axis("y", values),
        layers=[Marks(x=[2.0], y=[drawn])],
    )  # fmt: skip
    rows = [
        "".join(text for text, _ in row) for row in plot(picture, WIDTH, height, ascii_only=True)
    ]
    return [(row[: LABEL - 1].strip(), row[LABEL + 1 :]) for row in rows[1:-2]]


@pytest.mark.parametrize("values", [[-0.031, 0.104], [0.0, 2.7], [-5.0, 5.0], [-9.0, 0.3]])
def test_axis_number_is_in_the_row_of_its_value(values):
    for height in range(8, 34):
        shown = [text for text, _ in rows_of(values, values[0], height) if text]
        assert len(shown) >= 2
        for text in shown:
            value = float(text)
            rows = dict(rows_of(values, value, height))
            assert ("*" if value else ".") in rows[text], (height, text)
        zero_rows = [
            k
            for k, (_, drawn) in enumerate(rows_of(values, values[0], height))
            if ". ." in drawn or "..." in drawn
        ]
        assert len(zero_rows) == 1
