"""The plots of a calibration: cost, condition, closure by pose, RVDT deviations."""

import math
from collections.abc import Sequence

import numpy as np

from operator_app import units
from operator_app.report.plots import plot
from operator_app.report.plots.plot import Axis, Picture, Shape
from operator_app.report.subject import Subject
from operator_app.units import CLOSURE_ANGLE, CLOSURE_LENGTH, Figure, Quantity, plural, significant
from solver.arrays import BoolArray, FloatArray
from solver.chain.sensors import Rvdt
from solver.diagnostics.rvdt_response import RvdtFigures
from solver.estimators.estimate import Estimate

SHAPES: tuple[tuple[Shape, str], ...] = (("dot", "a"), ("square", "b"), ("triangle", "d"))
ROTATIONS = {2: ("dx", "dy"), 3: ("rx", "ry", "rz")}
CURVE_POINTS = 61
KNOWN_SIGMAS = 2.0
"""Half-width of the uncertainty band about an RVDT's fitted deviations, in sigmas (95 %)."""
FAR_OFF = 2.5
"""A pose is marked if its closure error exceeds the rms by this factor."""


def _pose_axis(subject: Subject) -> Axis:
    return plot.axis("pose", [float(p.number) for p in subject.used], whole=True)


def costs(steps: Sequence[tuple[int, float]]) -> Picture:
    """Return the plot of an estimator's cost over its iterations, in powers of ten."""
    numbers = [float(number) for number, _ in steps]
    powers = [math.log10(max(cost, 1e-30)) for _, cost in steps]
    return Picture(
        ident="cost",
        title="Cost by iteration",
        description="Cost that remains after each iteration.",
        x=plot.axis("iteration", numbers, whole=True),
        y=plot.axis("cost, power of ten", powers),
        layers=[plot.Marks(x=numbers, y=powers)],
    )


def condition_trend(trend: Sequence[tuple[int, float]], limit: float) -> Picture:
    """Return the plot of the scaled condition number over the number of poses, on a log scale, with the limit."""
    numbers, values = [float(n) for n, _ in trend], [value for _, value in trend]
    x = plot.axis("poses", numbers, whole=True)
    shown = [units.CONDITION(value).shown for value in values]
    tips = [f"{n} poses: {text}" for (n, _), text in zip(trend, shown, strict=True)]
    dashed = plot.Polyline(
        x=(x.low, x.high), y=(limit, limit), class_="dashed", label=f"limit {limit:g}"
    )
    marks = plot.Marks(x=numbers, y=values, tips=tips, label="first poses")
    return Picture(
        ident="condition-trend",
        title="Condition number by number of poses",
        description=f"Scaled condition number of the first {trend[0][0]} to {trend[-1][0]} poses, log scale: "
        f"from {shown[0]} to {shown[-1]}; lower is better.",
        x=x,
        y=plot.log_axis("scaled condition number", [*values, limit]),
        layers=[dashed, plot.Polyline(x=numbers, y=values), marks],
    )


def residuals(subject: Subject, estimate: Estimate) -> tuple[Picture, ...]:
    """Return plots of the poses' closure errors (position, orientation, distance), calculated from the readings."""
    split, after = estimate.rotation_rows, estimate.sigmas
    position = after.position_m.rms, estimate.residual[:, split:]
    drawn = [_closure(subject, "position", CLOSURE_LENGTH, *position)]
    if split and after.orientation_rad is not None:
        turned = after.orientation_rad.rms, estimate.residual[:, :split]
        drawn.append(_closure(subject, "orientation", CLOSURE_ANGLE, *turned))
    return (*drawn, misses(subject, estimate))


def misses(subject: Subject, estimate: Estimate) -> Picture:
    """Return the plot of the distance between tool and fixture in every pose; large distances are marked."""
    miss = np.linalg.norm(estimate.residual[:, estimate.rotation_rows :], axis=1)
    rms = float(np.sqrt(np.mean(miss**2)))
    highlighted, values = miss > FAR_OFF * rms, CLOSURE_LENGTH.per_si * miss
    numbers = np.array([p.number for p in subject.used])
    limit = CLOSURE_LENGTH.per_si * FAR_OFF * rms
    band = plot.Band(low=0.0, high=limit, label=f"{FAR_OFF:g} rms")

    def marks(of: BoolArray, shape: Shape, class_: str, label: str = "") -> plot.Marks:
        x, y = numbers[of].tolist(), values[of].tolist()
        return plot.Marks(x=x, y=y, shape=shape, class_=class_, label=label)

    return Picture(
        ident="misses",
        title="How far each pose's loop fails to close",
        description=f"{plural(len(miss), 'pose')}; rms {Figure(rms, CLOSURE_LENGTH).with_unit}; "
        f"{plural(int(highlighted.sum()), 'pose')} beyond {FAR_OFF:g} times that.",
        x=_pose_axis(subject),
        y=plot.axis("distance", [0.0, limit, *values.tolist()], unit=CLOSURE_LENGTH.unit),
        layers=[band, marks(~highlighted, "dot", "a", "pose"), marks(highlighted, "square", "c")],
    )


def _closure(subject: Subject, kind: str, unit: Quantity, rms: float, rows: FloatArray) -> Picture:
    numbers = [p.number for p in subject.used]
    norms = np.linalg.norm(rows, axis=1)
    worst = int(np.argmax(norms))
    components = ("x", "y", "z") if kind == "position" else ROTATIONS[rows.shape[1]]
    spread, values = unit.per_si * rms, unit.per_si * rows
    layers: list[plot.Layer] = [plot.Band(low=-spread, high=spread, label="rms")]
    for k, (name, (shape, colour)) in enumerate(zip(components, SHAPES, strict=False)):
        tips = [
            f"pose {n}: {name} {Figure(v, unit).with_unit}"
            for n, v in zip(numbers, rows[:, k].tolist(), strict=True)
        ]
        y = values[:, k].tolist()
        layers.append(plot.Marks(x=numbers, y=y, shape=shape, class_=colour, label=name, tips=tips))
    return Picture(
        ident=f"closure-{kind}",
        title=f"Closure error by pose, {kind}",
        description=f"{plural(len(rows), 'pose')}; rms {Figure(rms, unit).with_unit} per "
        f"component (shaded); the largest is {Figure(float(norms[worst]), unit).with_unit} "
        f"at pose {numbers[worst]}.",
        x=_pose_axis(subject),
        y=plot.axis(f"{kind} error", [*values.flat, spread], unit=unit.unit, symmetric=True),
        layers=layers,
    )


def rvdt_deviations(subject: Subject, joint: int, figures: RvdtFigures) -> Picture:
    """Return the plot of an RVDT's deviations (reading minus angle from the loop), fitted curve and stated limits."""
    sensor = subject.procedure.arm.joints[joint - 1].sensor
    if not isinstance(sensor, Rvdt):
        raise TypeError(f"joint {joint} has no RVDT")
    grid = np.linspace(figures.curve.low, figures.curve.high, CURVE_POINTS)
    curve = figures.curve(grid)
    low, high = (Figure(float(v), CLOSURE_ANGLE) for v in (curve.min(), curve.max()))
    allowed = CLOSURE_ANGLE.per_si * sensor.linearity_rad
    x, y = _scaled(figures.angle_rad, units.ANGLE), _scaled(figures.deviation_rad, CLOSURE_ANGLE)
    tested = figures.angle_rad + figures.deviation_rad
    poses = subject.used
    if len(poses) != len(tested):
        # Repeated poses were tested as one, and of thousands of poses only some: find each by its reading.
        apart = np.abs(tested[:, None] - subject.readings_rad[:, joint - 1])
        poses = tuple(poses[k] for k in apart.argmin(axis=1))
    tips = [
        f"pose {p.number}: deviation {Figure(v, CLOSURE_ANGLE, places=2).with_unit} at "
        f"{Figure(a, units.ANGLE, places=2).with_unit}"
        for p, a, v in zip(
            poses, figures.angle_rad.tolist(), figures.deviation_rad.tolist(), strict=True
        )
    ]
    reading, add, sigma = figures.table_rad.T
    half = KNOWN_SIGMAS * sigma
    least, most = (_scaled(-add + sign * half, CLOSURE_ANGLE) for sign in (-1.0, 1.0))
    known_at, heights = _scaled(reading + add, units.ANGLE), _scaled(curve, CLOSURE_ANGLE)
    return Picture(
        ident=f"rvdt-{joint}",
        title=f"Joint {joint}: reading minus the angle measured by the loop",
        description=f"Curve from {low.shown} to {high.with_unit}; noise of a "
        f"single reading {Figure(figures.noise.lsb, units.LSB, digits=2).with_unit}. The specification allows "
        f"±{Figure(sensor.linearity_rad, CLOSURE_ANGLE).with_unit} about the best-fit line.",
        x=plot.axis(f"true angle of joint {joint}", x, unit=units.ANGLE.unit),
        y=plot.axis(
            "deviation", [*y, *least, *most, *heights], unit=CLOSURE_ANGLE.unit, symmetric=True
        ),
        layers=[
            plot.Band(low=-allowed, high=allowed, label=f"±{significant(allowed, 2)} allowed"),
            plot.Ribbon(x=known_at, low=least, high=most, label=f"±{KNOWN_SIGMAS:g} sigma"),
            plot.Marks(x=x, y=y, label="pose", tips=tips),
            plot.Polyline(x=_scaled(grid, units.ANGLE), y=heights, class_="b", label="curve"),
        ],
    )


def _scaled(values: FloatArray, quantity: Quantity) -> list[float]:
    return [*(quantity.per_si * values).tolist()]
