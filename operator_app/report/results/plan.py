"""A plan as text for a terminal of 80 columns, and as JSON."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from itertools import zip_longest
from typing import Any

import numpy as np

from fixtures.base import CheckKind, Severity
from operator_app import units
from operator_app.config.procedure import AcceptanceLimits
from operator_app.planning.advice import PlacementReport
from operator_app.planning.preview import PlannedPose, Preview
from operator_app.report.facts import CONDITION_PAPER
from operator_app.report.plots.braille import coverage_lines, region_lines
from operator_app.report.text import aligned, paragraph, warning
from operator_app.units import Figure, in_json, joints_named, quantity_of
from solver.chain.parameters import Parameter
from solver.design.drive_joints import RankedDrives

SHOWN_SETS, SHOWN_WEAKEST, SIGMA_PLACES = 6, 4, 4
ANGULAR = ("alpha", "theta")


def plan_text(shown: Preview, *, title: str, ascii_only: bool) -> str:
    """Return a plan as text for the operator."""
    reached, planned = "-#" if ascii_only else "─█"
    region = [
        "Path of the drive joints: dots can be reached, S is the start, lines the path",
        *region_lines(shown, ascii_only=ascii_only),
    ]
    coverage = [
        f"Ranges of the joints, deg: {reached} can be reached, {planned} planned poses",
        *coverage_lines(shown, ascii_only=ascii_only),
    ]
    texts = [paragraph(title), _checks(shown), _drives(shown), _poses(shown), _sigmas(shown)]
    blocks = [*texts, "\n".join(region), "\n".join(coverage)]
    return "\n\n".join(block for block in blocks if block)


def _checks(shown: Preview) -> str:
    return "\n".join(
        paragraph(f"  {c.text}", indent=2)
        if c.severity is Severity.OK
        else warning(f"{c.severity.value}: {c.text}: {c.remedy}")
        for c in shown.checks
        if c.severity is not Severity.OK or c.kind is CheckKind.FIXED
    )


def _drives(shown: Preview) -> str:
    drives, prediction = shown.choice.drives, shown.choice.prediction
    at_start = {r.drives: r for r in prediction.here}
    listed = [r for k, r in enumerate(prediction.region) if k < SHOWN_SETS or r.drives == drives]
    rows = [["joints", "score", "reach", "leverage", "at start", "passive", ""]]
    for r in listed:
        now = at_start.get(r.drives)
        joints = ("> " if r.drives == drives else "  ") + " ".join(map(str, r.drives))
        reach = "" if r.reach is None else f"{r.reach:.0%}"
        leverage = f"{r.leverage:.2f}", "" if now is None else f"{now.leverage:.2f}"
        passive = f"J{r.fastest_joint} x {r.fastest_passive:.1f}"
        rows.append([joints, f"{r.score:.2f}", reach, *leverage, passive, _verdict(r, now)])
    head = (
        f"Drive joints: exactly {shown.plan.manifold.motion.degrees} in position mode, the others free. Reach: "
        "share of the poses inside the ranges. Leverage: 0 at a singularity; its median over the region, and at "
        "the start. Passive: the free joint that moves most, by how much more than the drives."
    )
    subject = f"{joints_named(drives)} drive{'s' if len(drives) == 1 else ''}".capitalize()
    chosen = f"{subject} ({'; '.join(shown.choice.reasons)})."
    lines = [paragraph(head), aligned(rows), paragraph(chosen)]
    if also := ", ".join(joints_named(d) for d in shown.choice.sets if d != drives):
        lines.append(paragraph(f"A session may change to {also} to reach further poses."))
    return "\n".join(lines)


def _verdict(ranked: RankedDrives, now: RankedDrives | None) -> str:
    if not ranked.usable:
        return "not usable"
    if now is not None and not now.usable:
        return "singular at start"
    return ""


def _poses(shown: Preview) -> str:
    rows = [["#", "drive", *(f"J{j}" for j in range(1, shown.arm.joint_count + 1)), ""]]
    for number, pose in enumerate(shown.poses, 1):
        readings = (units.SPAN(angle).shown for angle in pose.q_rad.tolist())
        path = "no safe path" if pose.route is None else ""
        rows.append([str(number), " ".join(map(str, pose.drives)), *readings, path])
    known = f", beside {shown.captured} captured ones" if shown.captured else ""
    head = (
        f"{len(shown.poses)} poses in visiting order{known}: predicted readings in deg, of which "
        "the drives' are the targets"
    )
    return paragraph(head) + "\n" + aligned(rows)


def _sigmas(shown: Preview) -> str:
    cells = [_sigma(parameter, sigma) for parameter, sigma in shown.predicted_sigma]
    half, blank = (len(cells) + 1) // 2, list[str]()
    pairs = zip_longest(cells[:half], cells[half:], fillvalue=blank)
    rows = [["parameter", "unit", "sigma"] * 2, *([*left, *right] for left, right in pairs)]
    condition = shown.identifiability.scaled_condition_number
    weakest = ", ".join(shown.identifiability.weakest.parameters[:SHOWN_WEAKEST])
    poses = "captured and planned poses" if shown.captured else "planned poses"
    tail = (
        f"Scaled condition number of the {poses} {Figure(condition).shown} (the result warns "
        f"above {AcceptanceLimits().scaled_condition_number:g}; the paper had {CONDITION_PAPER}). "
        f"Weakest direction: {weakest}. The standard deviations include every error at the size that the files of "
        "arm and fixture state; a calibration estimates these sizes, and may find smaller ones."
    )
    head = "Predicted standard deviations after these poses"
    return f"{head}\n{aligned(rows)}\n{paragraph(tail)}"


def _sigma(parameter: Parameter, sigma: float) -> list[str]:
    figure = Figure(sigma, quantity_of(parameter), places=SIGMA_PLACES)
    shown = figure.shown if math.isfinite(sigma) else "unseen"
    return [parameter.name, figure.quantity.unit, shown]


def advice_text(
    ranked: tuple[PlacementReport, ...], parameters: dict[str, Parameter], joints: int
) -> str:
    """Return text on ranked hinge placements: tilt and shift from the present placement, and predicted sigmas."""
    if not ranked:
        return "No placement near the present one can be used."
    rows = [
        ["", "tilt", "shift", "uncertainty", "condition", "mobility", "drives", "poses"],
        ["", "deg", "mm", "of present", "scaled", "", "", ""],
    ]
    for number, r in enumerate(ranked, 1):
        tilt, shift = (
            units.WHOLE_DEGREES(r.mounted.tilt_rad),
            units.NOMINAL_LENGTH(r.mounted.shift_m),
        )
        condition = units.CONDITION(r.plan.design.scaled_condition_number).shown
        drives = " ".join(map(str, r.plan.ranked[0].drives))
        head = [str(number), tilt.shown, shift.shown, f"{r.gain:.0%}", condition]
        mobility, poses = r.plan.manifold.motion.degrees, len(r.plan.visits)
        rows.append([*head, str(mobility), drives, str(poses)])
    title = paragraph("Hinge placements, the best first; the present one is tilt 0, shift 0")
    placements = (_placement(k, r, parameters, joints) for k, r in enumerate(ranked, 1))
    return "\n".join([title, aligned(rows), *placements])


def _placement(
    number: int, placement: PlacementReport, parameters: dict[str, Parameter], joints: int
) -> str:
    entries = "; ".join(
        ", ".join(
            f"{name.replace('_n', f'_{joints}')} {kind(v).shown}"
            for name, v in placement.mounted.hinge.placement.items()
            if name.startswith(ANGULAR) is angles
        )
        + f" {kind.quantity.unit}"
        for kind, angles in ((units.MOUNTED_LENGTH, False), (units.NOMINAL_TWIST, True))
    )
    reached = ", ".join(
        f"J{j} {units.WHOLE_DEGREES(low).shown} to {units.WHOLE_DEGREES(high).shown}"
        for j, (low, high) in enumerate(placement.plan.reach_rad.tolist(), 1)
    )
    lines = [f"placement: {entries}", f"joint ranges reached: {reached}"]
    for quantity in (units.ANGLE, units.LENGTH):
        phrases = [
            f"{name} {Figure(sigma, quantity, places=SIGMA_PLACES).shown}"
            for name, sigma in placement.sigma.items()
            if quantity_of(parameters[name]) is quantity
        ]
        lines.append(f"sigmas in {quantity.unit}: {', '.join(phrases)}")
    lines += [f"! {c.text}: {c.remedy}" for c in placement.checks if c.severity is not Severity.OK]
    head = paragraph(f"{number}. {placement.text}", indent=3)
    return "\n".join(("", head, *(paragraph(f"   {text}", indent=5) for text in lines)))


def plan_json(shown: Preview, *, basis: str) -> dict[str, Any]:
    """Return a plan as a JSON object; `basis` states what the plan is based on, such as ``nominal geometry``."""
    choice, identifiability = shown.choice, shown.identifiability
    return {
        "basis": basis,
        "arm": shown.arm.name,
        "mobility": shown.plan.manifold.motion.degrees,
        "drives": {
            "joints": list(choice.drives),
            "sets": [list(drives) for drives in choice.sets],
            "reasons": list(choice.reasons),
            "at_start": [_ranked_json(r) for r in choice.prediction.here],
            "over_region": [_ranked_json(r) for r in choice.prediction.region],
        },
        "checks": [c.data for c in shown.checks],
        "captured": shown.captured,
        "poses": [_pose_json(k, pose) for k, pose in enumerate(shown.poses, 1)],
        "sigma": {p.name: in_json(p, sigma) for p, sigma in shown.predicted_sigma},
        "scaled_condition_number": Figure(identifiability.scaled_condition_number).in_json,
        "rank": identifiability.rank,
        "weakest_direction": list(identifiability.weakest.parameters),
        "candidates": shown.plan.manifold.size,
        "reachable": int(shown.plan.allowed.sum()),
        "reach_deg": np.rad2deg(shown.plan.reach_rad).tolist(),
    }


def _ranked_json(ranked: RankedDrives) -> dict[str, Any]:
    data = asdict(ranked)
    return {"joints": data.pop("drives"), **data}


def advice_json(
    ranked: tuple[PlacementReport, ...], parameters: Mapping[str, Parameter]
) -> list[dict[str, Any]]:
    """Return ranked hinge placements as JSON objects."""
    return [
        {
            "text": placement.text,
            "gain": placement.gain,
            "tilt_deg": math.degrees(placement.mounted.tilt_rad),
            "shift_mm": 1e3 * placement.mounted.shift_m,
            "placement": dict(
                (f"{name}_deg", math.degrees(v))
                if name.startswith(ANGULAR)
                else (f"{name}_mm", 1e3 * v)
                for name, v in placement.mounted.hinge.placement.items()
            ),
            "mobility": placement.plan.manifold.motion.degrees,
            "reach_deg": np.rad2deg(placement.plan.reach_rad).tolist(),
            "drives": [_ranked_json(r) for r in placement.plan.ranked[:3]],
            "poses": len(placement.plan.visits),
            "scaled_condition_number": Figure(
                placement.plan.design.scaled_condition_number
            ).in_json,
            "sigma": {
                name: in_json(parameters[name], sigma) for name, sigma in placement.sigma.items()
            },
            "checks": [c.data for c in placement.checks],
        }
        for placement in ranked
    ]


def _pose_json(number: int, pose: PlannedPose) -> dict[str, Any]:
    degrees = np.rad2deg(pose.q_rad).tolist()
    legs = [
        {"drives": list(leg.drives), "waypoints_deg": np.rad2deg(leg.waypoints_rad).tolist()}
        for leg in pose.route or ()
    ]
    return {
        "number": number,
        "drives": list(pose.drives),
        "targets_deg": {str(j): degrees[j - 1] for j in pose.drives},
        "predicted_deg": degrees,
        "way": None if pose.route is None else legs,
    }
