"""The plots of a report: closure by pose, corrections by joint, coverage, RVDT curves. Knows no page."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from operator_app.report.markup import Html
from operator_app.report.section import figure
from operator_app.report.session_facts import CORRECTION_ODD, sensed_joints
from operator_app.report.strips import Range, Strip, ranges, strips
from operator_app.report.subject import Subject
from operator_app.report.svg import Axis, Band, Layer, Line, Marks, Shape, axis, plot
from operator_app.units.figure import (
    ANGLE,
    CLOSURE_ANGLE,
    CLOSURE_LENGTH,
    LSB,
    SHARE,
    Figure,
    Quantity,
)
from operator_app.units.numbers import plural
from solver.arrays import FloatArray
from solver.chain.sensors import Rvdt
from solver.estimators.estimate import Estimate
from solver.judging.rvdt_figures import RvdtFigures

SHAPES: tuple[tuple[Shape, str], ...] = (("dot", "a"), ("square", "b"), ("triangle", "d"))
ROTATIONS = {2: ("dx", "dy"), 3: ("rx", "ry", "rz")}
CURVE_POINTS = 61


def pose_axis(subject: Subject) -> Axis:
    """Axis of pose numbers."""
    return axis("pose", [float(p.number) for p in subject.used], whole=True)


def closure_by_pose(subject: Subject, estimate: Estimate) -> tuple[Html, ...]:
    """Draw the closure error of every pose at the measured joints: position, then orientation."""
    split, after = estimate.rotation_rows, estimate.sigmas
    drawn = [("position", CLOSURE_LENGTH, after.position_m, estimate.residual[:, split:])]
    if split:
        turned = CLOSURE_ANGLE, after.orientation_rad, estimate.residual[:, :split]
        drawn.append(("orientation", *turned))
    return tuple(
        _closure(subject, kind, quantity, sigma.rms, rows) for kind, quantity, sigma, rows in drawn
    )


def _closure(subject: Subject, kind: str, quantity: Quantity, rms: float, rows: FloatArray) -> Html:
    numbers = [p.number for p in subject.used]
    norms = np.linalg.norm(rows, axis=1)
    worst = int(np.argmax(norms))
    components = ("x", "y", "z") if kind == "position" else ROTATIONS[rows.shape[1]]
    spread = quantity.per_si * rms
    values = quantity.per_si * rows
    layers: list[Layer] = [Band(low=-spread, high=spread, label="rms")]
    for k, (name, (shape, colour)) in enumerate(zip(components, SHAPES, strict=False)):
        tips = [
            f"pose {n}: {name} {Figure(v, quantity).with_unit}"
            for n, v in zip(numbers, rows[:, k].tolist(), strict=True)
        ]
        layers.append(
            Marks(
                x=numbers,
                y=values[:, k].tolist(),
                shape=shape,
                class_=colour,
                label=name,
                tips=tips,
            )
        )
    title = f"Closure error by pose, {kind}"
    return figure(
        title,
        plot(
            ident=f"closure-{kind}",
            title=f"{title}, in {quantity.unit}",
            description=f"{plural(len(rows), 'pose')}; rms {Figure(rms, quantity).with_unit} per "
            f"component (shaded); the largest is {Figure(float(norms[worst]), quantity).with_unit} "
            f"at pose {numbers[worst]}.",
            x=pose_axis(subject),
            y=axis(
                f"{kind} error",
                [*values.ravel().tolist(), spread],
                unit=quantity.unit,
                symmetric=True,
            ),
            layers=layers,
        ),
    )


def corrections_by_joint(subject: Subject, estimate: Estimate | None) -> Html | None:
    """Draw what was added to each joint's readings to close the loops; None where nothing was."""
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
            "joint's sensor. The table of joints holds the same as numbers.",
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
    degrees = np.rad2deg(subject.readings_rad)
    rows = [
        Range(
            name=f"joint {j}",
            low=math.degrees(joint.lower_rad),
            high=math.degrees(joint.upper_rad),
            values=degrees[:, j - 1].tolist(),
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


def rvdt_deviations(subject: Subject, joint: int, found: RvdtFigures) -> Html:
    """Draw one RVDT's reading less the angle the loop measures, with its curve and what is allowed."""
    grid = np.linspace(found.curve.low, found.curve.high, CURVE_POINTS)
    curve = found.curve(grid)
    allowed = _rvdt(subject, joint).linearity_rad
    low, high = (Figure(float(v), CLOSURE_ANGLE) for v in (curve.min(), curve.max()))
    return _rvdt_plot(
        subject,
        ident=f"rvdt-{joint}",
        title=f"Joint {joint}: reading less the angle the loop measures",
        description=f"Curve from {low.shown} to {high.with_unit}; noise of a "
        f"single reading {Figure(found.noise.lsb, LSB, digits=2).with_unit}. The specification allows "
        f"±{Figure(allowed, CLOSURE_ANGLE).with_unit} about the best-fit line.",
        labels=(f"true angle of joint {joint}", "deviation"),
        at_rad=found.angle_rad,
        values_rad=found.deviation_rad,
        allowed_rad=(allowed, "allowed"),
        curve_rad=(grid, curve),
    )


def rvdt_corrections(subject: Subject, estimate: Estimate, joint: int) -> Html:
    """Draw one RVDT joint's corrections against its reading, with the noise stated."""
    if estimate.corrections is None:
        raise ValueError("this estimator finds no corrections")
    values = estimate.corrections[:, joint - 1]
    noise = _rvdt(subject, joint).sigma_rad
    low, high = (Figure(float(v), CLOSURE_ANGLE) for v in (values.min(), values.max()))
    return _rvdt_plot(
        subject,
        ident=f"rvdt-used-{joint}",
        title=f"Joint {joint}: correction against reading",
        description=f"Corrections from {low.shown} to {high.with_unit}; shaded: the stated noise of "
        f"one reading, ±{Figure(noise, CLOSURE_ANGLE).with_unit}.",
        labels=(f"reading of joint {joint}", "correction"),
        at_rad=subject.readings_rad[:, joint - 1],
        values_rad=values,
        allowed_rad=(noise, "stated noise"),
    )


def _rvdt(subject: Subject, joint: int) -> Rvdt:
    sensor = subject.procedure.arm.joints[joint - 1].sensor
    if not isinstance(sensor, Rvdt):
        raise TypeError(f"joint {joint} has no RVDT")
    return sensor


def _rvdt_plot(
    subject: Subject,
    *,
    ident: str,
    title: str,
    description: str,
    labels: tuple[str, str],
    at_rad: FloatArray,
    values_rad: FloatArray,
    allowed_rad: tuple[float, str],
    curve_rad: tuple[FloatArray, FloatArray] | None = None,
) -> Html:
    """Draw values (m,) over angles (m,), within a band about zero."""
    x_label, y_label = labels
    x, y = _scaled(at_rad, ANGLE), _scaled(values_rad, CLOSURE_ANGLE)
    allowed, name = CLOSURE_ANGLE.per_si * allowed_rad[0], allowed_rad[1]
    tips = [
        f"pose {p.number}: {y_label} {Figure(v, CLOSURE_ANGLE, places=2).with_unit} at "
        f"{Figure(a, ANGLE, places=2).with_unit}"
        for p, a, v in zip(subject.used, at_rad.tolist(), values_rad.tolist(), strict=True)
    ]
    layers: list[Layer] = [
        Band(low=-allowed, high=allowed, label=name),
        Marks(x=x, y=y, label="pose", tips=tips),
    ]
    if curve_rad is not None:
        curve = Line(
            x=_scaled(curve_rad[0], ANGLE),
            y=_scaled(curve_rad[1], CLOSURE_ANGLE),
            class_="b",
            label="curve",
        )
        layers.append(curve)
        y = [*y, *curve.y]
    drawn = plot(
        ident=ident,
        title=title,
        description=description,
        x=axis(x_label, x, unit=ANGLE.unit),
        y=axis(y_label, y, unit=CLOSURE_ANGLE.unit, symmetric=True),
        layers=layers,
    )
    return figure(title, drawn)


def _scaled(values: FloatArray, quantity: Quantity) -> list[float]:
    scaled: Sequence[float] = (quantity.per_si * values).tolist()
    return list(scaled)
