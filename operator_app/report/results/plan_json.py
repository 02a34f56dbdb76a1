"""A plan as the JSON object of `sarcal plan --json`. The key names are a contract.

Angles in deg, lengths in m, as everywhere in our JSON. Computes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from operator_app.units.figure import Figure, in_json

if TYPE_CHECKING:
    from fixtures.advice import RankedPlacement
    from operator_app.planning.preview import PlannedPose, Preview
    from solver.chain.parameters import Parameter
    from solver.design.drive_joints import RankedDrives


def plan_json(shown: Preview, *, basis: str) -> dict[str, Any]:
    """Return the object for a plan."""
    choice, seen = shown.choice, shown.seen
    known = {p.name: p for p in shown.parameters}
    names = shown.plan.information.parameters
    return {
        "basis": basis,
        "arm": shown.arm.name,
        "mobility": shown.mobility,
        "drives": {
            "joints": list(choice.drives),
            "sets": [list(drives) for drives in choice.sets],
            "reasons": list(choice.reasons),
            "at_start": [ranked_json(r) for r in choice.prediction.here],
            "over_region": [ranked_json(r) for r in choice.prediction.region],
        },
        "checks": [c.data for c in shown.checks],
        "captured": shown.captured,
        "poses": [_pose_json(k, pose) for k, pose in enumerate(shown.poses, 1)],
        "sigma": {
            name: in_json(known[name], float(sigma))
            for name, sigma in zip(names, shown.plan.predicted_sigma, strict=True)
        },
        "scaled_condition_number": Figure(seen.scaled_condition_number).in_json,
        "rank": seen.rank,
        "weakest_direction": list(seen.weakest.parameters),
        "candidates": shown.plan.manifold.size,
        "reachable": int(shown.plan.allowed.sum()),
        "reach_deg": np.rad2deg(shown.reach_rad).tolist(),
    }


def ranked_json(ranked: RankedDrives) -> dict[str, Any]:
    """Return one ranked set of drive joints."""
    return {
        "joints": list(ranked.drives),
        "score": ranked.score,
        "usable": ranked.usable,
        "leverage": ranked.leverage,
        "passive_conditioning": ranked.passive_conditioning,
        "fastest_passive": ranked.fastest_passive,
        "fastest_joint": ranked.fastest_joint,
        "still": list(ranked.still),
        "reach": ranked.reach,
        "reasons": list(ranked.reasons),
    }


def advice_json(
    ranked: tuple[RankedPlacement, ...], parameters: Mapping[str, Parameter]
) -> list[dict[str, Any]]:
    """Return ranked hinge placements."""
    return [_placement_json(placement, parameters) for placement in ranked]


def _placement_json(
    placement: RankedPlacement, parameters: Mapping[str, Parameter]
) -> dict[str, Any]:
    report = placement.report
    hinge = report.mounted.hinge
    return {
        "text": placement.text,
        "gain": placement.gain,
        "tilt_deg": math.degrees(report.mounted.tilt_rad),
        "shift_mm": 1e3 * report.mounted.shift_m,
        "placement": {
            "a_0_mm": 1e3 * hinge.a_0_m,
            "s_0_mm": 1e3 * hinge.s_0_m,
            "alpha_0_deg": math.degrees(hinge.alpha_0_rad),
            "s_1_mm": 1e3 * hinge.s_1_m,
            "a_n_mm": 1e3 * hinge.a_n_m,
            "s_n_mm": 1e3 * hinge.s_n_m,
            "alpha_n_deg": math.degrees(hinge.alpha_n_rad),
        },
        "mobility": report.mobility,
        "reach_deg": np.rad2deg(report.reach_rad).tolist(),
        "drives": [ranked_json(r) for r in report.drives],
        "poses": report.poses,
        "scaled_condition_number": Figure(report.scaled_condition_number).in_json,
        "sigma": {name: in_json(parameters[name], sigma) for name, sigma in report.sigma.items()},
        "checks": [c.data for c in report.checks],
    }


def _pose_json(number: int, pose: PlannedPose) -> dict[str, Any]:
    degrees = np.rad2deg(pose.q_rad).tolist()
    legs = () if pose.route is None else pose.route.legs
    return {
        "number": number,
        "drives": list(pose.drives),
        "targets_deg": {str(j): degrees[j - 1] for j in pose.drives},
        "predicted_deg": degrees,
        "way": None
        if pose.route is None
        else [
            {"drives": list(leg.drives), "waypoints_deg": np.rad2deg(leg.waypoints_rad).tolist()}
            for leg in legs
        ],
    }
