"""A calibration as the JSON object of `sarcal solve --json`. The key names are a contract.

Angles in deg, lengths in m, as the keys of `formats`; sigmas of the closure in mm and mrad.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from operator_app.calibration.checks import Checks
from operator_app.calibration.judgement import Notice
from operator_app.calibration.solve import Solution
from solver.chain.parameters import Parameter
from solver.errors import UnidentifiableDirection
from solver.estimators.estimate import Estimate
from solver.estimators.goodness import TwoReadings
from solver.estimators.variance_components import VarianceComponents
from solver.judging.holdout import HoldOut
from solver.judging.rvdt import RvdtVerdict
from solver.judging.statistics import chi2_test, correlations, intervals

ACCEPTED = "accepted"
NOT_ACCEPTED = "not accepted"
NOT_IDENTIFIABLE = "not identifiable"


def solution_json(solution: Solution) -> dict[str, Any]:
    """Return the object for a solved calibration."""
    estimate = solution.identified
    return {
        **estimate_json(estimate),
        **components_json(solution.components),
        "rvdt": [rvdt_json(verdict) for verdict in solution.rvdt],
        "outlier_poses": list(solution.outliers),
        "held": list(solution.held),
        "tolerated": list(solution.tolerated),
        "tolerated_parameters": _tolerated_json(solution),
        "repeatability": _repeatability_json(solution),
        "budget": _budget_json(solution),
        "stated_chi2_per_dof": None
        if solution.components is None
        else solution.components.stated_chi2 / solution.components.stated_dof,
        "assumed": list(solution.assumed),
        "global_start": _search_json(solution),
        "rank": solution.seen.rank,
        "unidentifiable": [],
        "scaled_condition_number": _finite(solution.seen.scaled_condition_number),
        "condition_number": _finite(solution.seen.condition_number),
        "observability": dict(
            zip(("O1", "O2", "O3", "O4", "O5"), solution.seen.observability, strict=True)
        ),
        "weakest_direction": list(solution.seen.weakest.parameters),
        "nominal": {p.name: in_file_units(p, p.nominal) for p in estimate.parameters},
        "before": {
            "sigma_pos_mm": both_json(solution.before.position_m),
            "sigma_ori_mrad": both_json(solution.before.orientation_rad),
        },
        "poses": solution.poses,
        "verdict": ACCEPTED if solution.accepted else NOT_ACCEPTED,
        "verdict_reasons": list(solution.reasons),
        "warnings": notices_json(solution.warnings),
    }


def _tolerated_json(solution: Solution) -> dict[str, dict[str, float]]:
    """Lengths (m) and twists (deg) corrected within their tolerances."""
    estimate = solution.estimate
    return {
        p.name: {
            "nominal": in_file_units(p, p.nominal),
            "value": in_file_units(p, float(x)),
            "sigma": in_file_units(p, float(s)),
        }
        for p, x, s in zip(
            estimate.parameters, estimate.x, estimate.standard_deviation, strict=True
        )
        if p.name in solution.tolerated
    }


def _repeatability_json(solution: Solution) -> dict[str, float] | None:
    """Type A: standard deviations of what the same poses taken again would give."""
    if solution.components is None:
        return None
    sd = np.sqrt(np.diagonal(solution.components.repeatability))
    return {
        p.name: in_file_units(p, float(s))
        for p, s in zip(solution.estimate.parameters, sd, strict=True)
        if p.name not in solution.tolerated
    }


def _budget_json(solution: Solution) -> dict[str, dict[str, float]]:
    """Share of every parameter's variance that each source of error brings; they add up to 1."""
    if solution.components is None:
        return {}
    total = np.diagonal(solution.estimate.covariance)
    return {
        p.name: {
            source: float(values[k] / total[k]) if total[k] > 0.0 else 0.0
            for source, values in solution.components.budget.items()
        }
        for k, p in enumerate(solution.estimate.parameters)
        if p.name not in solution.tolerated
    }


def checks_json(solution: Solution, checks: Checks) -> dict[str, Any]:
    """Return the second opinions: jackknife, hold-out, far block."""
    return {
        "jackknife_sigma": None
        if checks.jackknife_sd is None
        else _named(solution.identified, checks.jackknife_sd),
        "hold_out": _hold_out_json(checks.held_out),
        "far_block": _hold_out_json(checks.far_block),
    }


def _hold_out_json(found: HoldOut | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "parts": len(found.parts),
        "sigma_pos_mm": {
            "inside": 1e3 * found.inside_sigmas.position_m.rms,
            "held_out": 1e3 * found.sigmas.position_m.rms,
        },
        "sigma_ori_mrad": {
            "inside": 1e3 * found.inside_sigmas.orientation_rad.rms,
            "held_out": 1e3 * found.sigmas.orientation_rad.rms,
        },
        "chi2_per_dof": [part.verification.chi2.per_dof for part in found.parts],
    }


def estimate_json(estimate: Estimate) -> dict[str, Any]:
    """Return what one estimator found."""
    return {
        "estimator": estimate.estimator,
        "parameters": _named(estimate, estimate.x),
        "sigma": _named(estimate, estimate.standard_deviation),
        "interval_95": {
            p.name: [in_file_units(p, i.low), in_file_units(p, i.high)]
            for p, i in zip(estimate.parameters, intervals(estimate), strict=True)
        },
        "correlations": correlations(estimate.covariance).tolist(),
        "sigma_pos_mm": both_json(estimate.sigmas.position_m),
        "sigma_ori_mrad": both_json(estimate.sigmas.orientation_rad),
        "chi2_per_dof": estimate.chi2_per_dof,
        "chi2_band_99": _band_json(estimate),
        "variance_components": {},
        "dof": estimate.dof,
        "iterations": estimate.iterations,
        "converged": estimate.converged,
    }


def _band_json(estimate: Estimate) -> list[float] | None:
    if estimate.chi2 is None:
        return None
    band = chi2_test(estimate.chi2, estimate.dof)
    return [band.low, band.high]


def components_json(found: VarianceComponents | None) -> dict[str, Any]:
    """Return noise and flexure found with the parameters, in mrad and mm, with 95 % intervals."""
    if found is None:
        return {"variance_components": {}}
    names = {
        c.name: f"fixture_{'mrad' if c.unit == 'rad' else 'mm'}"
        if c.name.startswith("fixture")
        else f"{c.name}_mrad"
        for c in found.components
    }
    values = {names[c.name]: 1e3 * c.sd for c in found.components}
    if found.flexure is not None:
        # Kept at zero unless the data ask for it: said as zero, not left out.
        values = {"fixture_mm": 0.0, "fixture_mrad": 0.0, **values}
    return {
        "variance_components": values,
        "variance_components_interval": {
            names[c.name]: [1e3 * c.low, 1e3 * c.high] for c in found.components
        },
        "flexure_p_value": None if found.flexure is None else found.flexure.p_value,
    }


def rvdt_json(verdict: RvdtVerdict) -> dict[str, Any]:
    """Return what the loops say of one RVDT; angles in deg, the curve as a correction table."""
    figures = verdict.figures
    found: dict[str, Any] = {
        "joint": verdict.joint,
        "verdict": verdict.verdict.value,
        "text": verdict.text,
        "treat_as_unsensed": verdict.treat_as_unsensed,
        "share_of_residual": verdict.share,
    }
    if figures is not None:
        found |= {
            "linearity_percent_of_full_scale": 100.0 * figures.linearity,
            "linearity_sd_percent": 100.0 * figures.linearity_sd,
            "half_range_percent_of_full_scale": 100.0 * figures.half_range,
            "covered_percent_of_full_scale": 100.0 * figures.covered,
            "gain": figures.gain,
            "noise_lsb": figures.noise_lsb,
            "noise_lsb_interval": [figures.noise_low, figures.noise_high],
            "theta_off_deg": math.degrees(figures.theta_off_rad),
            "correction_table_deg": [
                dict(zip(("reading", "correction", "sigma"), row, strict=True))
                for row in np.rad2deg(figures.table_rad).tolist()
            ],
        }
    return found


def _search_json(solution: Solution) -> dict[str, Any] | None:
    found = solution.search
    if found is None:
        return None
    return {
        "starts": found.starts,
        "starts_in_best": found.best.starts,
        "distinct_solutions": 1 + len(found.rivals),
    }


def unidentifiable_json(
    directions: tuple[UnidentifiableDirection, ...], *, parameters: int, poses: int
) -> dict[str, Any]:
    """Return the object for a pose set that leaves parameters undetermined (exit code 5)."""
    return {
        "parameters": {},
        "sigma": {},
        "rank": parameters - len(directions),
        "unidentifiable": [d.parameters[0] for d in directions],
        "unidentifiable_directions": [
            {"parameters": list(d.parameters), "reason": d.reason, "text": str(d)}
            for d in directions
        ],
        "scaled_condition_number": None,
        "sigma_pos_mm": None,
        "sigma_ori_mrad": None,
        "chi2_per_dof": None,
        "variance_components": {},
        "poses": poses,
        "iterations": 0,
        "verdict": NOT_IDENTIFIABLE,
        "verdict_reasons": [str(d) for d in directions],
        "warnings": [],
    }


def notices_json(notices: tuple[Notice, ...]) -> list[dict[str, str]]:
    """Return warnings as code and text."""
    return [{"code": n.code, "text": n.text} for n in notices]


def in_file_units(parameter: Parameter, value: float) -> float:
    """Angle in deg, length in m."""
    return math.degrees(value) if parameter.is_angle else float(value)


def _named(estimate: Estimate, values: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, float]:
    return {
        p.name: in_file_units(p, float(v)) for p, v in zip(estimate.parameters, values, strict=True)
    }


def both_json(figure: TwoReadings) -> dict[str, float]:
    """m to mm, rad to mrad."""
    return {"rms": 1e3 * figure.rms, "as_printed": 1e3 * figure.as_printed}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
