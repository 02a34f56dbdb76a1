"""The braille canvas: which dot is where, independent of rounding errors."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from operator_app.report.plots.braille import Canvas, region_lines


def text(canvas: Canvas) -> list[str]:
    return ["".join(span for span, _ in row) for row in canvas.lines()]


OUTSIDE = [(x, y, " ") for x, y in ((-0.5, 1), (1, -0.5), (2, 1), (1, 4), (-3, -3))]


@pytest.mark.parametrize(
    ("x", "y", "character"),
    [(0, 0, "⠁"), (0, 3, "⡀"), (1, 0, "⠈"), (1, 3, "⢀"), (0.9, 2.9, "⠄"), *OUTSIDE],
)
def test_dot_is_its_braille_character_or_outside_the_canvas(x, y, character):
    canvas = Canvas(1, 1, ascii_only=False)
    canvas.dot(x, y)
    assert text(canvas) == [character]


@pytest.mark.parametrize("ascii_only", [False, True])
def test_rounding_errors_move_no_dot(ascii_only):
    def drawing(off):
        canvas = Canvas(12, 4, ascii_only=ascii_only)
        canvas.segment(off, 8 + off, 23 + off, 8 + off, every=3)
        canvas.segment(2 + off, off, 20 - off, 15 + off)
        canvas.blob(6 + off, 3 + off)
        canvas.letter(10 + off, 12 + off, "B")
        return text(canvas)

    assert drawing(-1e-12) == drawing(0.0) == drawing(1e-12)


def test_segment_has_a_dot_in_every_column():
    canvas = Canvas(10, 5, ascii_only=True)
    canvas.segment(0, 0, 19, 9)
    marked = np.array([[c != " " for c in row] for row in text(canvas)])
    assert marked.any(axis=0).all()


@pytest.mark.parametrize("poses", [3, 40])
def test_pose_numbers_without_room_are_listed_below(poses):
    """All poses are at one place, with room for some ten numbers."""
    manifold = SimpleNamespace(q=np.array([[0.0, 0.0], [1.0, 1.0]]))
    shown = SimpleNamespace(
        plan=SimpleNamespace(manifold=manifold, allowed=np.array([True, True])),
        choice=SimpleNamespace(drives=(1, 2)),
        poses=[SimpleNamespace(q_rad=np.array([0.5, 0.5]), route=None)] * poses,
    )
    text = "\n".join(region_lines(shown, ascii_only=True))  # type: ignore[arg-type]
    drawn, *below = text.split("lack of room: ")
    assert len(below) == (poses == 40)
    numbers = [int(number) for number in re.findall(r"\d+", "".join(below))]
    first = numbers[0] if numbers else poses + 1
    assert numbers == list(range(first, poses + 1))
    assert all(str(n) in drawn for n in range(1, first))
