"""A comparison of two calibrations as text and as JSON. Computes nothing, prints nothing."""

from __future__ import annotations

import math
from typing import Any

from operator_app.calibration.compare import Comparison, Drift, Side
from operator_app.config.parameters import ParametersDocument
from operator_app.report.json_result import notices_json
from operator_app.report.text import aligned, paragraph, warnings_text

DRIFTED = "drifted"
NO_DRIFT = "no significant drift"


def comparison_text(found: Comparison) -> str:
    """Return everything worth knowing, the verdict first, for a terminal of 80 columns."""
    blocks = [
        _verdict(found),
        "\n".join(_whose(name, d) for name, d in (("A", found.before), ("B", found.after))),
        _table(found),
        paragraph(
            f"Significant: a change of more than {found.threshold_sigmas:.2f} sigmas, which noise alone "
            f"gives to any of {len(found.drifts)} parameters in {100.0 * found.level:g} % of "
            "comparisons (Bonferroni). Change is B less A, angles the short way round."
        ),
        _left_out(found),
        warnings_text(found.notices),
    ]
    return "\n\n".join(block for block in blocks if block)


def comparison_json(found: Comparison) -> dict[str, Any]:
    """Return the object of `sarcal compare --json`: deg and m, as in the documents."""
    return {
        "verdict": DRIFTED if found.drifted else NO_DRIFT,
        "drifted": [d.name for d in found.drifted],
        "level": found.level,
        "threshold_sigmas": found.threshold_sigmas,
        "parameters": {
            d.name: {
                "unit": "deg" if d.is_angle else "m",
                "a": _in_file_units(d, d.before),
                "b": _in_file_units(d, d.after),
                "change": _in_file_units(d, d.change),
                "sigma": _in_file_units(d, d.sigma),
                "sigmas": d.sigmas if math.isfinite(d.sigmas) else None,
                "significant": d.significant,
                "side": d.side.name.lower(),
            }
            for d in found.drifts
        },
        "left_out": dict(found.left_out),
        "a": _document_json(found.before, found.scale_before),
        "b": _document_json(found.after, found.scale_after),
        "warnings": notices_json(found.notices),
    }


def _verdict(found: Comparison) -> str:
    if not found.drifted:
        return "NO SIGNIFICANT DRIFT."
    lines = [
        paragraph(
            f"- {d.name} by {_number(d, d.change, signed=True)} {_unit(d)} "
            f"({_sigmas(d)} sigmas; {d.side.value})",
            indent=2,
        )
        for d in found.drifted
    ]
    sides = {d.side for d in found.drifted}
    advice = ""
    if Side.ARM not in sides:
        advice = (
            "Only parameters of the fixture's mounting changed, none of the arm itself. If the fixture "
            "was taken off in between, compare with --remounted; if not, look whether it has moved."
        )
    else:
        advice = (
            "The arm itself changed. Calibrate once more; if the change stays, look at the encoders' "
            "home marks and couplings of the joints named, and export the new parameters."
        )
    return "\n".join(["DRIFTED:", *lines, paragraph(advice)])


def _whose(name: str, document: ParametersDocument) -> str:
    return (
        f"{name}  {document.arm.model} {document.arm.serial}, fixture {document.fixture.name}, "
        f"{document.utc:%Y-%m-%d %H:%M} UTC\n   {document.estimator}, "
        f"{document.quality.poses} poses, sarcal {document.software_version}"
    )


def _table(found: Comparison) -> str:
    rows = [["parameter", "unit", "A", "B", "change", "sigma", "sigmas", ""]]
    rows += [
        [
            d.name,
            _unit(d),
            _number(d, d.before),
            _number(d, d.after),
            _number(d, d.change, signed=True),
            _number(d, d.sigma),
            _sigmas(d),
            "DRIFT" if d.significant else "",
        ]
        for d in found.drifts
    ]
    return aligned(rows)


def _left_out(found: Comparison) -> str:
    by_reason: dict[str, list[str]] = {}
    for name, why in found.left_out:
        by_reason.setdefault(why, []).append(name)
    return "\n".join(
        paragraph(f"Not compared ({why}): {', '.join(names)}", indent=2)
        for why, names in by_reason.items()
    )


def _unit(drift: Drift) -> str:
    return "deg" if drift.is_angle else "mm"


def _number(drift: Drift, value: float, *, signed: bool = False) -> str:
    shown = value * (180.0 / math.pi if drift.is_angle else 1e3)
    # Rounded first, so that what rounds to nothing shows no sign.
    shown = round(shown, 4) + 0.0
    return f"{shown:{'+' if signed and shown else ''}.4f}"


def _sigmas(drift: Drift) -> str:
    if not math.isfinite(drift.sigmas):
        return "no sigma"
    return f"{drift.sigmas:.1f}" if drift.sigmas < 1e4 else f"{drift.sigmas:.1e}"


def _in_file_units(drift: Drift, value: float) -> float:
    return math.degrees(value) if drift.is_angle else value


def _document_json(document: ParametersDocument, scale: float) -> dict[str, Any]:
    return {
        "arm_model": document.arm.model,
        "arm_serial": document.arm.serial,
        "fixture": document.fixture.name,
        "fixture_kind": document.fixture.kind,
        "utc": document.utc.isoformat().replace("+00:00", "Z"),
        "estimator": document.estimator,
        "poses": document.quality.poses,
        "chi2_per_dof": document.quality.chi2_per_dof,
        "sigma_scale": scale,
        "pose_set_sha256": document.pose_set_sha256,
        "software_version": document.software_version,
    }
