"""Plots that only the page has: corrections and coverage by joint; a picture under its caption."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from operator_app.report.html.markup import figure
from operator_app.report.plots.calibration_plots import pose_axis
from operator_app.report.plots.strips import Range, Strip, ranges, strips
from operator_app.report.plots.svg import plot
from operator_app.report.session_tables import CORRECTION_ODD, sensed_joints
from operator_app.units.figure import ANGLE, CLOSURE_ANGLE, SHARE, Figure

if TYPE_CHECKING:
    from operator_app.report.html.markup import Html
    from operator_app.report.plots.plot import Picture
    from operator_app.report.subject import Subject
    from solver.estimators.estimate import Estimate


def drawn(picture: Picture) -> Html:
    """Return a picture under its caption."""
    return figure(picture.title, plot(picture))


def corrections_by_joint(subject: Subject, estimate: Estimate | None) -> Html | None:
    """Draw the corrections of each joint's readings that close the loops; None without any."""
    if estimate is None or estimate.corrections is None:
        return None
    values = CLOSURE_ANGLE.per_si * estimate.corrections
    noise = CLOSURE_ANGLE.per_si * subject.procedure.arm.sigma_rad()
    rms = np.sqrt(np.mean(values**2, axis=0))
    return figure(
        "Corrections that close the loops, joint by joint",
        strips(
            ident="corrections",
            title="Corrections of the joint readings by pose, in mrad",
            description="One row a joint, each on its own scale; shaded: one standard deviation of the "
            "joint's sensor. The table of joints has the same figures.",
            unit=CLOSURE_ANGLE.unit,
            x=pose_axis(subject),
            at=[float(p.number) for p in subject.used],
            rows=[
                Strip(
                    name=f"joint {j}",
                    values=values[:, j - 1].tolist(),
                    band=float(noise[j - 1]),
                    odd=bool(rms[j - 1] > CORRECTION_ODD * noise[j - 1]),
                )
                for j in sensed_joints(subject)
            ],
        ),
    )


def coverage(subject: Subject) -> Html:
    """Draw how much of each joint's range the poses cover."""
    scale, readings = ANGLE.per_si, ANGLE.per_si * subject.readings_rad
    rows = [
        Range(
            name=f"joint {j}",
            low=scale * joint.lower_rad,
            high=scale * joint.upper_rad,
            values=readings[:, j - 1].tolist(),
        )
        for j, joint in enumerate(subject.procedure.arm.joints, 1)
    ]
    least = min(rows, key=lambda row: row.covered)
    title = "Joint ranges and what the poses cover of them"
    return figure(
        title,
        ranges(
            ident="coverage",
            title=title,
            description=f"One bar a joint from end to end of its range, one tick a pose. "
            f"{least.name.capitalize()} is covered least, "
            f"{Figure(least.covered, SHARE, places=0).with_unit}.",
            unit=ANGLE.unit,
            rows=rows,
        ),
    )
