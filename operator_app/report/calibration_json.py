"""Parts of a calibration's JSON object that are in no table. Scripts use the key names: do not change them.

Angles in deg, lengths in m.
"""

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from operator_app.calibration.acceptance import Verdict
from operator_app.calibration.calibrated_arm import side_of
from operator_app.calibration.cross_validation import Checks
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.instrument_registration import (
    InstrumentStation,
    instrument_stations,
    with_registered_instrument,
)
from operator_app.calibration.result import Solution
from operator_app.calibration.sensitivity import source_sensitivities
from operator_app.messages.finding import Finding
from operator_app.units import ANGLE, Figure
from solver.arrays import FloatArray
from solver.chain.rotations import rotation_vector
from solver.diagnostics.rvdt import RvdtVerdict
from solver.diagnostics.statistics import chi2_test, correlations
from solver.errors import UnidentifiableError
from solver.estimators.estimate import Estimate
from solver.estimators.variance_components import VarianceComponents


def calibration_data(solution: Solution) -> dict[str, Any]:
    """Return the part of a calibration's JSON data that is in no table."""
    search = solution.search
    accuracy_needs = () if solution.accuracy is None else solution.accuracy.holds_for
    return {
        **estimate_data(solution.identified),
        **_components_data(solution.components),
        "instrument_placements": [_station_data(s) for s in instrument_stations(solution)],
        "side": {p.name: side_of(solution.model, p.name) for p in solution.identified.parameters},
        "rvdt": [_rvdt_data(verdict) for verdict in solution.rvdt],
        "outlier_poses": list(solution.outliers),
        "held": list(solution.held),
        "hand_accuracy_holds_for": {
            h.name: h.value_rad * ANGLE.json_per_si for h in accuracy_needs
        },
        "tolerated": list(solution.tolerated),
        "tolerated_parameters": {},
        "repeatability": None,
        "budget": {},
        "halved": {
            h.parameter.name: {"source": h.source, "share": h.share, "remedy": h.remedy}
            for h in source_sensitivities(solution)
        },
        "stated_chi2_per_dof": solution.adjudication.stated_chi2_per_dof,
        "assumed": list(solution.assumed),
        "global_start": search
        and {
            "starts": search.starts,
            "starts_in_best": search.best.starts,
            "distinct_solutions": 1 + len(search.alternatives),
        },
        "scaled_condition_number_at_readings": None,
        "unidentifiable": [],
        "weakest_direction": list(solution.identifiability.weakest.parameters),
        "observability": {
            f"O{k}": Figure(index).in_json
            for k, index in enumerate(solution.identifiability.observability, 1)
        },
        "verdict": solution.verdict.value,
        "causes": [
            {"code": c.code, "probability": c.probability, "text": c.text, "remedy": c.remedy}
            for c in solution.causes
        ],
        "tests": [
            {
                "code": t.code,
                "statistic": t.statistic if math.isfinite(t.statistic) else None,
                "threshold": t.threshold if math.isfinite(t.threshold) else None,
                "false_alarm": t.false_alarm,
            }
            for t in solution.adjudication.tests
        ],
        "verdict_reasons": list(solution.reasons),
        "warnings": notices_data(solution.warnings),
    }


def _station_data(station: InstrumentStation) -> dict[str, Any]:
    def place(T: FloatArray, *, turns: bool) -> dict[str, Any]:
        turn_deg = np.rad2deg(rotation_vector(T[:3, :3])).tolist()
        return {
            "position_m": T[:3, 3].tolist(),
            "rotation_vector_deg": turn_deg if turns else None,
            "matrix": T.tolist() if turns else None,
        }

    return {
        "placement": station.placement,
        "T_instrument_base": place(station.T_instrument_base, turns=True),
        "T_flange_target": place(station.T_flange_target, turns=station.full_pose),
    }


def estimate_data(estimate: Estimate) -> dict[str, Any]:
    """Return the part of an estimator's JSON data that is in no table."""
    band = None if estimate.chi2 is None else chi2_test(estimate.chi2, estimate.dof)
    return {
        "estimator": estimate.estimator,
        "correlations": correlations(estimate.covariance).tolist(),
        "chi2_per_dof": None,
        "chi2_band_99": None if band is None else [band.low, band.high],
        "variance_components": {},
        "dof": estimate.dof,
        "iterations": estimate.iterations,
        "converged": estimate.converged,
    }


def checks_data(checks: Checks | None) -> dict[str, Any]:
    """Return the JSON data of the cross-validation and the jackknife; empty if `checks` is None."""
    if checks is None:
        return {}
    data: dict[str, Any] = {"jackknife_sigma": None}
    for key, held_out in (("hold_out", checks.held_out), ("far_block", checks.far_block)):
        parts = [] if held_out is None else [part.per_dof for part in held_out.parts]
        data[key] = held_out and {"parts": len(parts), "chi2_per_dof": parts}
    return {"checks": data}


def _components_data(components: VarianceComponents | None) -> dict[str, Any]:
    if components is None:
        return {}
    # Zeros if no deflection of the fixture was estimated; otherwise figures of `components_table` replace them.
    rigid = {} if components.compliance is None else {"fixture_mm": 0.0, "fixture_mrad": 0.0}
    return {
        "variance_components": rigid,
        "variance_components_interval": {},
        "flexure_p_value": None if components.compliance is None else components.compliance.p_value,
    }


def _rvdt_data(verdict: RvdtVerdict) -> dict[str, Any]:
    figures = verdict.figures
    data: dict[str, Any] = {
        "joint": verdict.joint,
        "verdict": verdict.verdict.value,
        "text": verdict.text,
        "treat_as_unsensed": verdict.treat_as_unsensed,
        "share_of_residual": verdict.share,
    }
    if (noise := verdict.noise) is not None:
        data |= {"noise_lsb": noise.lsb, "noise_lsb_interval": [noise.low, noise.high]}
    if figures is not None:
        data |= {
            "linearity_percent_of_full_scale": 100.0 * figures.linearity,
            "linearity_sd_percent": 100.0 * figures.linearity_sd,
            "half_range_percent_of_full_scale": 100.0 * figures.half_range,
            "covered_percent_of_full_scale": 100.0 * figures.covered,
            "gain": figures.gain,
            "theta_off_deg": math.degrees(figures.theta_off_rad),
            "correction_table_deg": [
                dict(zip(("reading", "correction", "sigma"), row, strict=True))
                for row in np.rad2deg(figures.table_rad).tolist()
            ],
        }
    return data


RESULTS_AS_OBJECTS = (
    "nominal", "repeatability", "side", "halved", "tolerated_parameters", "observability",
    "hand_accuracy_holds_for", "variance_components", "variance_components_interval", "parameters", "sigma",
    "interval_95", "budget", "shares", "scales", "best_table",
)  # fmt: skip
RESULTS_AS_LISTS = (
    "correlations", "corrections", "corrections_dh", "condition_trend", "held", "outlier_poses", "rvdt",
    "tolerated", "weakest_direction", "assumed", "distances", "tests", "warnings",
    "instrument_placements",
)  # fmt: skip
RESULTS_AS_FIGURES = (
    "before", "chi2_band_99", "condition_number", "flexure_p_value", "global_start", "hand_accuracy_mm",
    "scaled_condition_number", "scaled_condition_number_at_readings", "sigma_pos_mm", "sigma_ori_mrad",
    "chi2_per_dof", "stated_chi2_per_dof", "tip_sigma_mm", "best_table_tool_sigma_mm", "with_best_table",
    "with_corrections",
)  # fmt: skip
"""Keys of figures, whose value is null if the poses leave parameters undetermined."""


def unidentifiable_data(
    error: UnidentifiableError, experiment: Experiment, *, estimator: str
) -> dict[str, Any]:
    """Return the JSON object for poses that leave parameters undetermined (exit code 5).

    The object has the same keys as that of a calibration; the values of results are empty or null.
    """
    directions, poses, arm = error.directions, len(experiment.poses), experiment.arm
    # As in the calibration: an instrument may measure points only, and joints may have no sensor.
    model = replace(
        experiment,
        fixture=with_registered_instrument(arm, experiment.fixture, experiment.poses),
        unsensed=tuple(sorted({*experiment.unsensed, *arm.unsensed_joints})),
    ).loop()
    parameters = len(model.parameters)
    causes = [{"code": error.code, "probability": 1.0, "text": error.note, "remedy": ""}]
    return {
        **{key: {} for key in RESULTS_AS_OBJECTS},
        **{key: [] for key in RESULTS_AS_LISTS},
        **dict.fromkeys(RESULTS_AS_FIGURES),
        "estimator": estimator,
        "dof": poses * model.equations_per_pose - parameters,
        "converged": False,
        "iterations": 0,
        "poses": poses,
        "rank": parameters - len(directions),
        "unidentifiable": [d.parameters[0] for d in directions],
        "unidentifiable_directions": [
            {"parameters": list(d.parameters), "reason": d.reason, "text": str(d)}
            for d in directions
        ],
        "verdict": Verdict.NOT_ACCEPTED.value,
        "verdict_reasons": [str(d) for d in directions],
        "causes": causes if error.note else [],
    }


def notices_data(notices: Iterable[Finding]) -> list[dict[str, str]]:
    """Return the code and the text of each warning."""
    return [{"code": n.code, "text": n.sentence} for n in notices]
