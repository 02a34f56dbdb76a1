"""The plots of a report: closure by pose, corrections by joint, coverage, RVDT curves. Knows no page."""

from __future__ import annotations

import math

import numpy as np

from operator_app.report.markup import Html
from operator_app.report.numbers import fixed, plural, significant
from operator_app.report.strips import Range, Strip, ranges, strips
from operator_app.report.subject import Subject
from operator_app.report.svg import Axis, Band, Line, Marks, Shape, axis, plot
from solver.arrays import FloatArray
from solver.chain.sensors import NoSensor, Rvdt
from solver.estimators.estimate import Estimate
from solver.judging.rvdt_figures import RvdtFigures

SHAPES: tuple[tuple[Shape, str], ...] = (("dot", "a"), ("square", "b"), ("triangle", "d"))
ROTATIONS = {2: ("dx", "dy"), 3: ("rx", "ry", "rz")}
CURVE_POINTS = 61

CORRECTION_ODD = 3.0
"""A joint whose corrections are this many times its sensor's noise (rms) is marked."""


def pose_axis(subject: Subject) -> Axis:
    """Axis of pose numbers."""
    return axis("pose", [float(p.number) for p in subject.used], whole=True)


def closure_by_pose(subject: Subject, estimate: Estimate) -> tuple[Html, ...]:
    """Draw the closure error of every pose at the measured joints: position, then orientation."""
    split = estimate.rotation_rows
    blocks: list[tuple[str, str, FloatArray, tuple[str, ...]]] = [
        ("position", "mm", estimate.residual[:, split:], ("x", "y", "z"))
    ]
    if split:
        blocks.append(("orientation", "mrad", estimate.residual[:, :split], ROTATIONS[split]))
    sigma = {
        "position": estimate.sigmas.position_m.rms,
        "orientation": estimate.sigmas.orientation_rad.rms,
    }
    made = []
    numbers = [float(p.number) for p in subject.used]
    for kind, unit, rows, components in blocks:
        values = 1e3 * rows
        spread = 1e3 * sigma[kind]
        worst = int(np.argmax(np.linalg.norm(values, axis=1)))
        made.append(
            plot(
                ident=f"closure-{kind}",
                title=f"Closure error by pose, {kind}, in {unit}",
                description=f"{plural(len(values), 'pose')}; rms {significant(spread)} {unit} per "
                f"component (shaded); the largest is {significant(_norm(values, worst))} {unit} "
                f"at pose {numbers[worst]:.0f}.",
                x=pose_axis(subject),
                y=axis(
                    f"{kind} error",
                    [*values.ravel().tolist(), spread],
                    unit=unit,
                    symmetric=True,
                ),
                layers=[
                    Band(low=-spread, high=spread, label="rms"),
                    *(
                        Marks(
                            x=numbers,
                            y=values[:, k].tolist(),
                            shape=shape,
                            class_=colour,
                            label=name,
                            tips=[
                                f"pose {n:.0f}: {name} {significant(float(v))} {unit}"
                                for n, v in zip(numbers, values[:, k], strict=True)
                            ],
                        )
                        for k, (name, (shape, colour)) in enumerate(
                            zip(components, SHAPES, strict=False)
                        )
                    ),
                ],
            )
        )
    return tuple(made)


def corrections_by_joint(subject: Subject, estimate: Estimate) -> Html | None:
    """Draw what was added to each joint's readings to close the loops; None where nothing was."""
    if estimate.corrections is None:
        return None
    sigma = subject.procedure.arm.sigma_rad()
    rows = []
    for j in sensed_joints(subject):
        values = 1e3 * estimate.corrections[:, j - 1]
        noise = 1e3 * float(sigma[j - 1])
        rms = float(np.sqrt(np.mean(values**2)))
        rows.append(
            Strip(
                name=f"joint {j}",
                values=values.tolist(),
                band=noise,
                odd=rms > CORRECTION_ODD * noise,
            )
        )
    return strips(
        ident="corrections",
        title="Corrections of the joint readings by pose, in mrad",
        description="One row a joint, each on its own scale; shaded: one standard deviation of the "
        "joint's sensor. The table of joints holds the same as numbers.",
        unit="mrad",
        x=pose_axis(subject),
        at=[float(p.number) for p in subject.used],
        rows=rows,
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
    return ranges(
        ident="coverage",
        title="Joint ranges and what the poses cover of them",
        description=f"One bar a joint from end to end of its range, one tick a pose. "
        f"{least.name.capitalize()} is covered least, {fixed(100.0 * least.covered, 0)} %.",
        unit="deg",
        rows=rows,
    )


def rvdt_joints(subject: Subject) -> tuple[int, ...]:
    """Joints that are read by an RVDT."""
    return tuple(
        j
        for j, joint in enumerate(subject.procedure.arm.joints, 1)
        if isinstance(joint.sensor, Rvdt)
    )


def sensed_joints(subject: Subject) -> tuple[int, ...]:
    """Joints whose readings were used."""
    return tuple(
        j
        for j, joint in enumerate(subject.procedure.arm.joints, 1)
        if j not in subject.unsensed_joints and not isinstance(joint.sensor, NoSensor)
    )


def rvdt_deviations(subject: Subject, joint: int, found: RvdtFigures) -> Html:
    """Draw one RVDT's reading less the angle the loop measures, with its curve and what is allowed."""
    sensor = subject.procedure.arm.joints[joint - 1].sensor
    if not isinstance(sensor, Rvdt):
        raise TypeError(f"joint {joint} has no RVDT")
    values = 1e3 * found.deviation_rad
    grid = np.linspace(found.curve.low, found.curve.high, CURVE_POINTS)
    curve = 1e3 * found.curve(grid)
    allowed = 1e3 * sensor.linearity_rad
    return plot(
        ident=f"rvdt-{joint}",
        title=f"Joint {joint}: reading less the angle that the loop measures",
        description=f"Curve from {significant(float(curve.min()))} to "
        f"{significant(float(curve.max()))} mrad; noise about it "
        f"{significant(found.noise_lsb, 2)} LSB. The specification allows ±{significant(allowed)} "
        "mrad about the best-fit line.",
        x=axis(f"true angle of joint {joint}", np.rad2deg(found.angle_rad).tolist(), unit="deg"),
        y=axis("deviation", [*values.tolist(), *curve.tolist()], unit="mrad", symmetric=True),
        layers=[
            Band(low=-allowed, high=allowed, label="allowed"),
            Marks(
                x=np.rad2deg(found.angle_rad).tolist(),
                y=values.tolist(),
                label="pose",
                tips=[
                    f"pose {p.number}: {fixed(float(v), 2)} mrad at {fixed(math.degrees(a), 2)} deg"
                    for p, a, v in zip(subject.used, found.angle_rad.tolist(), values, strict=True)
                ],
            ),
            Line(x=np.rad2deg(grid).tolist(), y=curve.tolist(), class_="b", label="curve"),
        ],
    )


def rvdt_corrections(subject: Subject, estimate: Estimate, joint: int) -> Html:
    """Draw one RVDT joint's corrections against its reading, with the noise stated."""
    sensor = subject.procedure.arm.joints[joint - 1].sensor
    if not isinstance(sensor, Rvdt) or estimate.corrections is None:
        raise ValueError("only corrections of an RVDT joint can be drawn against its reading")
    reading = subject.readings_rad[:, joint - 1]
    correction = estimate.corrections[:, joint - 1]
    noise = 1e3 * sensor.sigma_rad
    values = 1e3 * correction
    return plot(
        ident=f"rvdt-used-{joint}",
        title=f"Joint {joint}: correction against reading",
        description=f"Corrections from {significant(float(values.min()))} to "
        f"{significant(float(values.max()))} mrad; shaded: the stated noise of one reading, "
        f"±{significant(noise)} mrad.",
        x=axis(f"reading of joint {joint}", np.rad2deg(reading).tolist(), unit="deg"),
        y=axis("correction", values.tolist(), unit="mrad", symmetric=True),
        layers=[
            Band(low=-noise, high=noise, label="stated noise"),
            Marks(
                x=np.rad2deg(reading).tolist(),
                y=values.tolist(),
                label="pose",
                tips=[
                    f"pose {p.number}: reading {fixed(math.degrees(q), 2)} deg, correction "
                    f"{fixed(float(v), 2)} mrad"
                    for p, q, v in zip(subject.used, reading, values, strict=True)
                ],
            ),
        ],
    )


def _norm(values: FloatArray, row: int) -> float:
    return float(np.linalg.norm(values[row]))
