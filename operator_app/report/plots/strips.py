"""Rows of small SVG plots, one per joint: values over poses, and ranges with the part covered by poses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from operator_app.report.html.markup import Html, figure
from operator_app.report.plots.calibration_plots import pose_axis
from operator_app.report.plots.plot import Axis, Shape
from operator_app.report.plots.svg import (
    PLOT_WIDTH,
    RIGHT,
    Drawn,
    label,
    mark,
    picture,
    rectangle,
    segment,
    ticks,
)
from operator_app.report.session_tables import CORRECTION_ODD, sensed_joints, stated_rad
from operator_app.units import ANGLE, CLOSURE_ANGLE, SHARE, Figure, fixed, significant

if TYPE_CHECKING:
    from operator_app.report.subject import Subject
    from solver.estimators.estimate import Estimate


ROW = 34.0
NAME_WIDTH = 74.0
SCALE_WIDTH = 40.0
HEAD, FOOT = 16.0, 32.0
BAR_HEIGHT, LEGEND = 13.0, 12.0


def corrections_by_joint(subject: Subject, estimate: Estimate | None) -> Html | None:
    """Draw the corrections to each joint's readings that close the loops; None without corrections.

    One row per joint over the pose numbers; each has its own scale, mrad, written at its right end.
    """
    if estimate is None or estimate.corrections is None:
        return None
    arm, joints, x = subject.procedure.arm, sensed_joints(subject), pose_axis(subject)
    corrections = CLOSURE_ANGLE.per_si * estimate.corrections
    noise, stated = CLOSURE_ANGLE.per_si * np.array([arm.sigma_rad(), stated_rad(arm)])
    rms = np.sqrt(np.mean(corrections**2, axis=0))
    right = RIGHT - SCALE_WIDTH
    full_scale = f"full scale [±{CLOSURE_ANGLE.unit}]"
    parts = [label(full_scale, PLOT_WIDTH - 2.0, 10.0, class_="axis", anchor="end")]
    for k, j in enumerate(joints):
        values, sd = corrections[:, j - 1].tolist(), float(noise[j - 1])
        top = HEAD + ROW * k
        middle, half = top + 0.5 * ROW, 0.5 * ROW - 3.0
        reach = max([abs(v) for v in values if math.isfinite(v)] + [sd, 1e-12])
        band = half * sd / reach
        parts += [
            rectangle(NAME_WIDTH, middle - band, right - NAME_WIDTH, 2.0 * band, "band"),
            segment(NAME_WIDTH, middle, right, middle, "zero"),
            segment(2.0, top + ROW, PLOT_WIDTH - 2.0, top + ROW, "grid"),
            label(f"joint {j}", 2.0, middle + 3.6, class_="legend"),
            label(significant(reach, 2), PLOT_WIDTH - 2.0, middle + 3.6, anchor="end"),
        ]
        colour = "c" if 0.0 < CORRECTION_ODD * stated[j - 1] < rms[j - 1] else "a"
        for pose, value in zip(subject.used, values, strict=True):
            x_at = x.place(float(pose.number), NAME_WIDTH, right)
            y = middle - half * value / reach
            parts.append(segment(x_at, middle, x_at, y, f"stem {colour}"))
            parts.append(mark("dot", x_at, y, 1.7, colour))
    foot = HEAD + ROW * len(joints)
    drawn = picture(
        "corrections",
        "Corrections of the joint readings by pose, in mrad",
        "One row per joint, each on its own scale; shaded: one standard deviation of the joint's sensor. The table "
        "of joints has the same figures.",
        foot + FOOT,
        [*parts, *_x_axis(x, right, foot)],
    )
    return figure("Corrections that close the loops, joint by joint", drawn)


def _x_axis(x: Axis, right: float, foot: float) -> list[Html]:
    """Draw the ticks and title of the axis that all rows share."""
    title = label(x.title, right, foot + FOOT - 3.0, class_="axis", anchor="end")
    return [*ticks(x, NAME_WIDTH, right, foot), title]


@dataclass(frozen=True, slots=True, kw_only=True)
class Bars:
    """Named rows on one x axis, each with marks and bars.

    Attributes
    ----------
    bars
        By label: start and end of a bar for each row.
    marks
        By label: one value for each row; non-finite values are not drawn.
    """

    x: Axis
    names: Sequence[str]
    bars: Mapping[str, Sequence[tuple[float, float]]] = field(default_factory=dict)
    marks: Mapping[str, Sequence[float]] = field(default_factory=dict)


def bars(of: Bars) -> Drawn:
    """Draw the rows below a legend with three labels per line."""
    bars, labels = list(of.bars.values()), [*of.bars, *of.marks]
    top = LEGEND * -(-len(labels) // 3) + 6.0
    foot = top + BAR_HEIGHT * len(of.names)
    # A single kind of bar is the uncertainty of the marks; several are distinguished by colour.
    fill = "ribbon" if len(bars) == 1 else "bar b{}"
    shapes: list[tuple[Shape, str]] = [("dot", "a"), ("triangle", "c"), ("square", "d")]
    parts = []
    for k, legend in enumerate(labels):
        x, y = 2.0 + (k % 3) * (RIGHT - 2.0) / 3.0, LEGEND * (k // 3 + 1)
        if k < len(bars):
            sign = rectangle(x, y - 7.0, 9.0, 7.0, fill.format(k))
        else:
            shape, colour = shapes[k - len(bars)]
            sign = mark(shape, x + 4.0, y - 3.5, 2.4, colour)
        parts += [sign, label(legend, x + 12.0, y, class_="legend")]
    for value in of.x.ticks:
        x_at = of.x.place(value, NAME_WIDTH, RIGHT)
        parts.append(segment(x_at, top, x_at, foot, "zero" if value == 0.0 else "grid"))
    for k, name in enumerate(of.names):
        y = top + BAR_HEIGHT * k
        parts.append(label(name, 2.0, y + 8.6, class_="legend"))
        for number, pieces in enumerate(bars):
            start, end = (of.x.place(value, NAME_WIDTH, RIGHT) for value in pieces[k])
            width, class_ = max(0.0, end - start), fill.format(number)
            parts.append(rectangle(start, y + 2.0, width, BAR_HEIGHT - 4.0, class_))
        for (shape, colour), values in zip(shapes, of.marks.values(), strict=False):
            if math.isfinite(values[k]):
                x_at = of.x.place(values[k], NAME_WIDTH, RIGHT)
                parts.append(mark(shape, x_at, y + 0.5 * BAR_HEIGHT, 2.4, colour))
    return Drawn(foot + FOOT, (*parts, *_x_axis(of.x, RIGHT, foot)))


COVERAGE = "Joint ranges and the part that the poses cover"


def coverage(subject: Subject) -> Html:
    """Draw the range of each joint, deg, as a bar with a tick for each pose; the ends are written below the bar."""
    joints, readings = subject.procedure.arm.joints, ANGLE.per_si * subject.readings_rad
    right = RIGHT - SCALE_WIDTH
    parts = [
        label(f"end of range [{ANGLE.unit}]", NAME_WIDTH, 10.0, class_="axis"),
        label("covered [%]", PLOT_WIDTH - 2.0, 10.0, class_="axis", anchor="end"),
    ]
    covered: list[float] = []
    for k, joint in enumerate(joints):
        lower, upper = ANGLE.per_si * joint.lower_rad, ANGLE.per_si * joint.upper_rad
        values = readings[:, k].tolist()
        least, most = min(values), max(values)
        covered.append((most - least) / (upper - lower))
        low, high = min(lower, least), max(upper, most)
        scale = Axis(label="", unit=ANGLE.unit, low=low, high=high, ticks=())
        low, high, start, end, *marks = (
            scale.place(v, NAME_WIDTH, right) for v in (lower, upper, least, most, *values)
        )
        top = HEAD + ROW * k + 4.0
        parts += [
            label(f"joint {k + 1}", 2.0, top + 9.0, class_="legend"),
            rectangle(start, top, max(0.8, end - start), 11.0, "band"),
            rectangle(low, top, high - low, 11.0, "range"),
            *(segment(x, top, x, top + 11.0, "rug") for x in marks),
            label(fixed(lower, 0), low, top + 22.0),
            label(fixed(upper, 0), high, top + 22.0, anchor="end"),
            label(fixed(100.0 * covered[-1], 0), PLOT_WIDTH - 2.0, top + 9.0, anchor="end"),
        ]
    description = (
        "One bar per joint from end to end of its range, one tick per pose. "
        f"Joint {covered.index(min(covered)) + 1} is covered least, "
        f"{Figure(min(covered), SHARE, places=0).with_unit}."
    )
    height = HEAD + ROW * len(joints) + 4.0
    return figure(COVERAGE, picture("coverage", COVERAGE, description, height, parts))
