"""Tables of a session's joints, sensors and poses, for the HTML page."""

import math

import numpy as np

from operator_app import units
from operator_app.report.subject import Subject
from operator_app.report.table import Cell, FactTable, figures, words
from operator_app.units import Figure, Kind, places_needed
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.sensors import Encoder, NoSensor, Rvdt, Sensor, rms_per_amplitude
from solver.estimators.error_model import SD_OF_PEAK

CORRECTION = Kind(units.CLOSURE_ANGLE, digits=2)
CORRECTION_ODD = 3.0
"""A joint is marked if the rms of its corrections exceeds the uncertainty of its readings by this factor."""


def rvdt_joints(subject: Subject) -> tuple[int, ...]:
    """Return the joints (from 1) with an RVDT."""
    joints = enumerate(subject.procedure.arm.joints, 1)
    return tuple(j for j, joint in joints if isinstance(joint.sensor, Rvdt))


def joint_table(subject: Subject) -> FactTable:
    """Return the table of every joint's sensor, corrections and covered range."""
    arm, q, estimate = subject.procedure.arm, subject.readings_rad, subject.implicit
    unused = {*subject.unsensed_joints, *arm.unsensed_joints}
    sigma, stated = arm.sigma_rad(), _stated_rad(arm)
    rows: list[tuple[Cell, ...]] = []
    for j, joint in enumerate(arm.joints, 1):
        rms = None
        if estimate is not None and estimate.corrections is not None and j not in unused:
            rms = float(np.sqrt(np.mean(estimate.corrections[:, j - 1] ** 2)))
        noise = float(sigma[j - 1]) or None
        ratio = None if rms is None or noise is None else rms / float(stated[j - 1])
        low, high = float(q[:, j - 1].min()), float(q[:, j - 1].max())
        highlighted = ratio is not None and ratio > CORRECTION_ODD
        rows.append(
            (
                f"{j} {joint.name}",
                _sensor_words(joint.sensor, used=j not in unused),
                subject.state.modes[j - 1].value if subject.state.modes else units.NOT_AVAILABLE,
                *map(CORRECTION, (noise, float(stated[j - 1]) or None, rms)),
                Figure(ratio, digits=2, role="warn" if highlighted else "text"),
                *map(units.READING, (low, high)),
                units.PERCENT((high - low) / (joint.upper_rad - joint.lower_rad)),
            )
        )
    return FactTable(
        ident="joint-table",
        title="Joints: sensors, corrections that close the loops, coverage",
        columns=(
            *words("joint"),
            *words("sensor", "mode", detail=True),
            *figures("noise", unit="mrad", detail=True),
            *figures("stated", unit="mrad"),
            *figures("rms", unit="mrad", group="correction"),
            *figures("/ stated", group="correction"),
            *figures("from", "to", unit="deg", group="poses"),
            *figures("covered", unit="%"),
        ),
        rows=tuple(rows),
        note="Noise: of one reading. Stated: uncertainty of sensor, play and sag by the arm file; "
        f"▲ marks joints whose corrections exceed {CORRECTION_ODD:g} times this.",
    )


def _stated_rad(arm: ArmModel) -> FloatArray:
    """Return the stated standard uncertainty of each joint's reading (n,), rad."""
    encoder = math.sqrt(2.0) * arm.accuracy_rad  # errors once and twice per turn
    curve = rms_per_amplitude() * SD_OF_PEAK * arm.linearity_rad()
    parts = (arm.sigma_rad(), encoder, curve, arm.gain_rad(), arm.backlash_rad, arm.sag_rad)
    return np.asarray(np.sqrt(sum(part**2 for part in parts)))


def _sensor_words(sensor: Sensor, *, used: bool) -> str:
    match sensor:
        case Encoder():
            text = f"encoder, {sensor.counts_per_rev} counts/rev"
        case Rvdt():
            places = places_needed([units.ANGLE.per_si * sensor.full_scale_rad], least=0, most=3)
            full_scale = Figure(sensor.full_scale_rad, units.ANGLE, places=places).with_unit
            text = f"RVDT, {sensor.bits} bit over {full_scale}"
        case NoSensor():
            return "none"
    return text if used else f"{text} (reading not used)"


def rvdt_table(subject: Subject) -> FactTable | None:
    """Return the table of each RVDT's gain, linearity and noise, measured in the closed loop; None if not measured."""
    rows: list[tuple[Cell, ...]] = []
    for verdict in () if subject.solution is None else subject.solution.rvdt:
        sensor, result = subject.procedure.arm.joints[verdict.joint - 1].sensor, verdict.figures
        if result is None or not isinstance(sensor, Rvdt):
            continue
        linearity = (
            Figure(v, units.SHARE, places=2) for v in (result.linearity, result.linearity_sd)
        )
        noise = (result.noise.lsb, result.noise.low, result.noise.high, sensor.noise_lsb)
        rows.append(
            (
                f"joint {verdict.joint}",
                units.PERCENT(result.covered),
                Figure(result.gain, places=4),
                *linearity,
                units.LINEARITY(sensor.linearity),
                *(Figure(value, units.LSB, digits=2) for value in noise),
                units.PERCENT(verdict.share),
            )
        )
    single = "noise of a single reading"
    return None if not rows else FactTable(
        ident="rvdt-table",
        title="RVDT joints: readings against the angle that the loop measures",
        columns=(
            *words("joint"),
            *figures("covered", unit="% of full scale"),
            *figures("gain, reading per angle"),
            *figures("found", "sigma", "allowed", unit="%", group="linearity, of full scale"),
            *figures("found", "95 % from", "to", "allowed", unit="LSB", group=single),
            *figures("share of squared closure error", unit="%"),
        ),
        rows=tuple(rows),
    )  # fmt: skip


def pose_table(subject: Subject) -> FactTable:
    """Return the table of all captured poses with their closure errors, notes, and reasons for exclusion."""
    estimate = None if subject.solution is None else subject.solution.identified
    joints = range(1, subject.procedure.arm.joint_count + 1)
    days = {pose.utc[:10] for pose in subject.poses}
    day = f", {min(days)}" if len(days) == 1 and all(days) else ""
    row_of = {p.number: k for k, p in enumerate(subject.used)}

    def fit_residuals(k: int | None) -> tuple[Cell, ...]:
        if estimate is None or k is None:
            return units.NOT_AVAILABLE, units.NOT_AVAILABLE, units.NOT_AVAILABLE
        split = estimate.rotation_rows
        shifted = float(np.linalg.norm(estimate.residual[k, split:]))
        turned = float(np.linalg.norm(estimate.residual[k, :split])) if split else None
        chi2 = None if estimate.pose_chi2 is None else float(estimate.pose_chi2[k])
        return (
            Figure(shifted, units.CLOSURE_LENGTH),
            Figure(turned, units.CLOSURE_ANGLE),
            Figure(chi2),
        )

    rows: list[tuple[Cell, ...]] = []
    for pose in subject.poses:
        head = str(pose.number), pose.utc[11 if day else 0 : 19].replace("T", " ")
        readings = (Figure(v, units.ANGLE, places=3) for v in pose.mean_rad.tolist())
        sd = Figure(float(pose.sd_rad.max()), units.NOISE_ANGLE, places=1)
        remarks = [f"✕ excluded: {pose.excluded}"] if pose.excluded else []
        if pose.number in subject.flipped:
            remarks.append("✕ left out: tool upside down on the hinge (flipped branch)")
        remarks += [pose.note] if pose.note else []
        residuals = fit_residuals(row_of.get(pose.number))
        rows.append((*head, *readings, sd, *residuals, "; ".join(remarks)))
    return FactTable(
        ident="pose-table",
        title="Captured poses: mean joint readings, error of closure, notes",
        columns=(
            *words("pose", f"UTC{day}"),
            *figures(*map(str, joints), group="mean reading of joint [deg]"),
            *figures("largest sd", unit="mdeg"),
            *figures("position", unit="mm", group="closure error"),
            *figures("orientation", unit="mrad", group="closure error"),
            *figures("chi2"),
            *words("note"),
        ),
        rows=tuple(rows),
        out=frozenset(k for k, pose in enumerate(subject.poses) if pose.number not in row_of),
    )
