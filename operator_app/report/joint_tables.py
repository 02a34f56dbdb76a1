"""The tables of a report about joints and poses: sensors, corrections, RVDTs, captured poses. Knows no page."""

from __future__ import annotations

import math

import numpy as np

from operator_app.report.figures import (
    CORRECTION_ODD,
    ROTATIONS,
    sensed_joints,
)
from operator_app.report.markup import Column, Html, element, join, spoken, table
from operator_app.report.numbers import NOT_KNOWN, fixed, significant
from operator_app.report.subject import Subject
from solver.chain.sensors import Encoder, NoSensor, Rvdt
from solver.estimators.estimate import Estimate
from solver.judging.rvdt_figures import RvdtFigures


def joint_table(subject: Subject, estimate: Estimate | None) -> Html:
    """Sensor, corrections and coverage of every joint."""
    arm = subject.procedure.arm
    columns = [
        Column(title="joint", number=False),
        Column(title="sensor", number=False),
        Column(title="mode", number=False),
        Column(title="noise stated", unit="mrad"),
        Column(title="correction rms", unit="mrad"),
        Column(title="times noise"),
        Column(title="poses from", unit="deg"),
        Column(title="to", unit="deg"),
        Column(title="covered", unit="%"),
    ]
    q = subject.readings_rad
    sigma = arm.sigma_rad()
    used = sensed_joints(subject)
    rows = []
    for j, joint in enumerate(arm.joints, 1):
        rms = math.nan
        if estimate is not None and estimate.corrections is not None and j in used:
            rms = float(np.sqrt(np.mean(estimate.corrections[:, j - 1] ** 2)))
        noise = float(sigma[j - 1])
        ratio = rms / noise if noise > 0.0 else math.nan
        times = significant(ratio, 2)
        low, high = float(q[:, j - 1].min()), float(q[:, j - 1].max())
        rows.append(
            [
                join((f"{j} ", element("span", joint.name, class_="muted"))),
                sensor_words(joint.sensor, used=j in used),
                subject.modes[j - 1] if subject.modes else NOT_KNOWN,
                significant(1e3 * noise, 2) if noise > 0.0 else NOT_KNOWN,
                significant(1e3 * rms, 2),
                element("span", "▲ ", times, class_="warn") if ratio > CORRECTION_ODD else times,
                fixed(math.degrees(low), 2),
                fixed(math.degrees(high), 2),
                fixed(100.0 * (high - low) / (joint.upper_rad - joint.lower_rad), 0),
            ]
        )
    return table("Joints: sensors, corrections that close the loops, coverage", columns, rows)


def sensor_words(sensor: Encoder | Rvdt | NoSensor, *, used: bool) -> str:
    """Say what reads a joint."""
    match sensor:
        case Encoder():
            words = f"encoder, {sensor.counts_per_rev} counts/rev"
        case Rvdt():
            words = f"RVDT, {sensor.bits} bit over {math.degrees(sensor.full_scale_rad):g} deg"
        case NoSensor():
            return "none"
    return words if used else f"{words} (reading not used)"


def rvdt_table(subject: Subject) -> Html:
    """Each RVDT against the angle that the loop measures: line, curve, noise, and what is allowed."""
    columns = [
        Column(title="joint", number=False),
        Column(title="covered", unit="% of full scale"),
        Column(title="gain, reading per angle"),
        Column(title="found", unit="%", group="linearity, of full scale"),
        Column(title="sigma", unit="%", group="linearity, of full scale"),
        Column(title="allowed", unit="%", group="linearity, of full scale"),
        Column(title="found", unit="LSB", group="noise"),
        Column(title="95 % from", unit="LSB", group="noise"),
        Column(title="to", unit="LSB", group="noise"),
        Column(title="allowed", unit="LSB", group="noise"),
        Column(title="share of squared closure error", unit="%"),
    ]
    rows = []
    for verdict in subject.rvdt:
        sensor = subject.procedure.arm.joints[verdict.joint - 1].sensor
        found = verdict.figures
        if found is None or not isinstance(sensor, Rvdt):
            continue
        rows.append(
            [
                f"joint {verdict.joint}",
                fixed(100.0 * found.covered, 0),
                fixed(found.gain, 4),
                fixed(100.0 * found.linearity, 2),
                fixed(100.0 * found.linearity_sd, 2),
                f"{100.0 * sensor.linearity:g}",
                significant(found.noise_lsb, 2),
                significant(found.noise_low, 2),
                significant(found.noise_high, 2),
                f"{sensor.noise_lsb:g}",
                fixed(100.0 * verdict.share, 0),
            ]
        )
    return table("RVDT joints: readings against the angle that the loop measures", columns, rows)


def correction_table(joint: int, figures: RvdtFigures) -> Html:
    """What to add to an RVDT's readings, over the range the poses cover."""
    columns = [
        Column(title="reading", unit="deg", number=False),
        Column(title="add", unit="mrad"),
        Column(title="sigma", unit="mrad"),
    ]
    rows = [
        [
            fixed(math.degrees(reading), 2),
            fixed(1e3 * correction, 2, signed=True),
            fixed(1e3 * sigma, 2),
        ]
        for reading, correction, sigma in figures.table_rad[::2].tolist()
    ]
    return table(f"Joint {joint}: corrections by reading", columns, rows, class_="small")


def pose_table(subject: Subject, estimate: Estimate | None) -> Html:
    """All captured poses with what they left over, notes, and why some were left out."""
    n = subject.procedure.arm.joint_count
    noisy = estimate is not None and estimate.pose_chi2 is not None
    days = {pose.utc[:10] for pose in subject.poses}
    day = f", {min(days)}" if len(days) == 1 else ""
    columns = [
        Column(title="pose", number=False),
        Column(title=f"UTC{day}", number=False),
        *(Column(title=f"{j}", group="mean reading of joint [deg]") for j in range(1, n + 1)),
        Column(title="largest sd", unit="mdeg"),
        Column(title="position", unit="mm", group="closure error"),
        Column(title="orientation", unit="mrad", group="closure error"),
        *([Column(title="chi2")] if noisy else []),
        Column(title="note", number=False),
    ]
    row_of = {p.number: k for k, p in enumerate(subject.used)}
    rows, classes = [], []
    for pose in subject.poses:
        k = row_of.get(pose.number)
        cells = [
            str(pose.number),
            pose.utc[11 if day else 0 : 19].replace("T", " "),
            *(fixed(math.degrees(v), 3) for v in pose.mean_rad.tolist()),
            fixed(1e3 * math.degrees(float(pose.sd_rad.max())), 1),
        ]
        position, orientation = NOT_KNOWN, NOT_KNOWN
        if estimate is not None and k is not None:
            split = estimate.rotation_rows
            position = significant(1e3 * float(np.linalg.norm(estimate.residual[k, split:])))
            if split in ROTATIONS:
                orientation = significant(1e3 * float(np.linalg.norm(estimate.residual[k, :split])))
        cells += [position, orientation]
        if estimate is not None and estimate.pose_chi2 is not None:
            chi2 = NOT_KNOWN if k is None else significant(float(estimate.pose_chi2[k]))
            cells.append(chi2)
        cells.append(_remark(subject, pose.number, pose.note, pose.excluded))
        rows.append(cells)
        classes.append("" if k is not None else "out")
    return table(
        "Captured poses: mean joint readings, error of closure, notes",
        columns,
        rows,
        row_classes=classes,
    )


def _remark(subject: Subject, number: int, note: str, excluded: str) -> Html:
    parts: list[str] = []
    if excluded:
        parts.append(join(("✕ excluded: ", spoken(excluded))))
    if number in subject.flipped:
        parts.append("✕ left out: hand upside down on the hinge (flipped branch)")
    if note:
        parts.append(spoken(note))
    return element("span", join(parts, "; "), class_="remark")
