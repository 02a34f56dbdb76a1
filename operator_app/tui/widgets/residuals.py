"""Plots of a finished calibration: by pose, by joint, and each RVDT's curve. Knows one solution."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from operator_app.calibration.solution import Solution
from operator_app.report.spans import Line, line, wrapped
from operator_app.session.snapshot import SessionSnapshot
from operator_app.tui.widgets.plot import Axes, Series, plot
from solver.chain.sensors import Rvdt


def kept_numbers(s: SessionSnapshot, solution: Solution) -> list[int]:
    """Numbers of the poses that took part."""
    dropped = set(solution.dropped_flipped)
    return [p.number for k, p in enumerate(s.state.used_poses) if k not in dropped]


def by_pose(s: SessionSnapshot, width: int, height: int, *, ascii_only: bool) -> Sequence[Line]:
    """Closure of every pose, position part."""
    solution = s.solution
    if solution is None:
        return []
    estimate = solution.estimate
    miss = 1e3 * np.linalg.norm(estimate.residual[:, estimate.rotation_rows :], axis=1)
    numbers = [float(n) for n in kept_numbers(s, solution)][: len(miss)]
    rms = float(np.sqrt(np.mean(miss**2)))
    worst = miss > 2.5 * rms
    series = [
        Series(x=[n for n, w in zip(numbers, worst, strict=True) if not w],
               y=[float(v) for v, w in zip(miss, worst, strict=True) if not w]),
        Series(x=[n for n, w in zip(numbers, worst, strict=True) if w],
               y=[float(v) for v, w in zip(miss, worst, strict=True) if w], role="warn"),
    ]  # fmt: skip
    axes = Axes(x_label="pose", y_label="mm   lines: rms, 2.5 rms", levels=(0.0, rms, 2.5 * rms))
    return plot(series, axes, width, height, ascii_only=ascii_only)


def by_joint(s: SessionSnapshot, width: int) -> Sequence[Line]:
    """How much each joint had to be corrected for its loops to close, rms against its sensor."""
    solution = s.solution
    if solution is None:
        return []
    corrections = solution.estimate.corrections
    if corrections is None:
        return [line((" the paper's estimator finds no joint corrections", "dim"))]
    sigma = s.procedure.arm.sigma_rad()
    rms = np.sqrt(np.mean(corrections**2, axis=0))
    rows: list[Line] = [
        line((" rms correction by the loops,", "dim")),
        line((" beside the sensor's noise", "dim")),
        line((" J   [mdeg]  sensor  ratio", "header")),
    ]
    cells = max(0, min(30, width - 36))
    for k, (found, allowed) in enumerate(zip(rms, sigma, strict=True), 1):
        ratio = found / allowed if allowed > 0.0 else math.inf
        role, mark = ("warn", "▲") if ratio > 3.0 else ("text", " ")
        bar = "█" * min(cells, int(ratio / 10.0 * cells))
        shown = f"{ratio:6.1f}" if math.isfinite(ratio) else "     —"
        mdeg = [1e3 * math.degrees(v) for v in (found, allowed)]
        rows.append(line((f" {k} {mdeg[0]:8.3f} {mdeg[1]:7.2f} {shown} {mark} {bar}", role)))
    return rows


def rvdt_joints(s: SessionSnapshot) -> list[int]:
    """Joints (1-based) read by an RVDT."""
    return [k for k, j in enumerate(s.procedure.arm.joints, 1) if isinstance(j.sensor, Rvdt)]


def rvdt_curve(
    s: SessionSnapshot, joint: int, width: int, height: int, *, ascii_only: bool
) -> Sequence[Line]:
    """What the loops say of an RVDT: deviation over angle, its curve, its specification."""
    sensor = s.procedure.arm.joints[joint - 1].sensor
    found = (
        None if s.solution is None else next((v for v in s.solution.rvdt if v.joint == joint), None)
    )
    if found is None or not isinstance(sensor, Rvdt):
        return [line((f" the loops say nothing of J{joint}'s RVDT", "dim"))]
    words = wrapped(f" {found.text}", width, "warn" if found.treat_as_unsensed else "text", " ")
    if found.figures is None:
        return words
    figures = found.figures
    grid = np.linspace(figures.curve.low, figures.curve.high, 2 * width)
    limit = 1e3 * sensor.linearity_rad
    axes = Axes(
        x_label=f"J{joint} [deg]",
        y_label=f"mrad   lines: spec ±{limit:.0f}",
        levels=(-limit, 0.0, limit),
    )
    series = [
        Series(x=np.rad2deg(grid).tolist(), y=(1e3 * figures.curve(grid)).tolist(), role="accent"),
        Series(x=np.rad2deg(figures.angle_rad).tolist(), y=(1e3 * figures.deviation_rad).tolist()),
    ]
    room = max(8, height - len(words))
    picture = plot(series, axes, width, room, ascii_only=ascii_only)
    return [*picture, *words[: height - len(picture)]]
