"""Verification of a calibration with new poses, in a closed loop or with measured endpoints, as text and as JSON."""

from typing import Any

import numpy as np

from operator_app.calibration.open_loop import OpenLoopCheck
from operator_app.calibration.prediction import FIXTURE
from operator_app.calibration.verification import VerificationResult
from operator_app.report.quality_tables import CLOSURE_COLUMNS, closure_row, rows_in_use
from operator_app.report.results.comparison import change_cells, change_data
from operator_app.report.table import FactTable, figures, keyed, words
from operator_app.report.text import paragraph, table_lines, table_text, warning
from operator_app.units import ANGLE, CHI2, SIGMA_ORI, SIGMA_POS, Figure, significant
from solver.chain.poses import PoseSet
from solver.diagnostics.cross_validation import CommonShift
from solver.diagnostics.limits import DRIFT_FALSE_ALARM_PROBABILITY

OUTLIERS_LISTED = 5


def closure(verdict: VerificationResult) -> FactTable:
    """Return the table of closure sigmas of the new poses, with nominal and with calibrated parameters."""
    used = verdict.in_use
    return FactTable(
        ident="closure",
        title="Closure at the measured joints",
        columns=CLOSURE_COLUMNS,
        rows=(
            closure_row("nominal", verdict.nominal, key=("nominal",)),
            *rows_in_use(used.best_table, used.corrected, name="calibrated, {}"),
            closure_row("calibrated, entries alone", verdict.verification.sigmas, key=()),
        ),
    )


def verification_json(verdict: VerificationResult, poses: PoseSet) -> dict[str, Any]:
    """Return the object that `sarcal verify --json` prints."""
    chi2, shift = verdict.verification.chi2, verdict.shift
    return {
        "verdict": "holds" if verdict.holds else "does not hold",
        "poses": verdict.poses,
        "chi2_per_dof": chi2.per_dof,
        "chi2_band_99": [chi2.low, chi2.high],
        **keyed((closure(verdict),)),
        "odd_poses": [poses.label[k] for k in verdict.odd_poses],
        "shift": None if shift is None else _shift_json(shift, verdict.why),
    }


def _shift_json(shift: CommonShift, why: str) -> dict[str, Any]:
    joint = shift.subject != FIXTURE
    size, sigma = (Figure(v if joint else None, ANGLE).in_json for v in (shift.size, shift.sigma))
    return {
        "what": f"joint_{shift.subject}" if joint else shift.subject,
        "size_deg": size,
        "sigma_deg": sigma,
        "chi2": shift.chi2,
        "threshold": shift.threshold,
        "text": why,
    }


def verification_text(verdict: VerificationResult, poses: PoseSet, folder: str) -> str:
    """Return the verification as text for a terminal of 80 columns, the verdict first."""
    tested = verdict.verification
    # Only the test at stated sizes decides the verdict. Above a limit, its chi2 is shown.
    above = any(test.per_dof > test.high for test in (verdict.stated, tested.chi2))
    chi2 = verdict.stated if above else tested.chi2
    per_dof, most = (CHI2(v).shown for v in (chi2.per_dof, chi2.high))
    odd = len(verdict.odd_poses)
    if verdict.holds:
        head = (
            f"HOLDS: the calibration of {folder} predicts these {verdict.poses} poses within its stated "
            "uncertainty."
        )
    elif odd and verdict.others_fit:
        head = (
            f"DOES NOT HOLD: {odd} of {verdict.poses} new poses {'deviates' if odd == 1 else 'deviate'} by more "
            f"than chance allows; the others agree with the calibration of {folder}. Take the listed poses again."
        )
    else:
        head = (
            f"DOES NOT HOLD: {verdict.poses} new poses disagree with the calibration of {folder} "
            "by more than its uncertainty allows."
        )
    notices = [verdict.why] if verdict.why else []
    if verdict.odd_poses:
        worst = ", ".join(
            f"{poses.label[k]} (chance {significant(float(tested.pose_probability[k]), 2)})"
            for k in verdict.odd_poses[:OUTLIERS_LISTED]
        )
        notices.append(f"check pose {worst}")
    if not verdict.holds and not np.all(tested.closed):
        notices.append(
            "some poses cannot be closed at all: check whether the fixture was moved since, or whether their "
            "placement has the number of another one"
        )
    # Stated uncertainties are upper limits: a chi2 below its expected value is normal.
    note = f"chi2/dof {per_dof}: 1 or less if errors are as stated; at most one sound set in 200 exceeds {most}."
    blocks = [paragraph(head), "", table_text(closure(verdict)), paragraph(note)]
    return "\n".join([*blocks, *map(warning, notices)])


def verified_words(result: VerificationResult) -> str:
    """Return a verification in one line: verdict, closure sigmas (of the best D-H table, if there is one), chi2/dof."""
    sigmas = result.in_use.best_table or result.verification.sigmas
    ratio = CHI2(result.verification.chi2.per_dof).shown
    turned = sigmas.orientation_rad
    return (
        f"{result.poses} new poses, {result.verdict}: {SIGMA_POS(sigmas.position_m.rms).with_unit}"
        f"{'' if turned is None else f', {SIGMA_ORI(turned.rms).with_unit}'} rms, chi2/dof {ratio}"
    )


AGREES = "agrees"
DISAGREES = "disagrees"
UNSOUND = "open loop not accepted"


def open_loop_json(check: OpenLoopCheck) -> dict[str, Any]:
    """Return the object that `sarcal verify --open-loop --json` prints; angles in deg, lengths in m."""
    return {
        "verdict": _verdict(check),
        "disagree": [d.name for d in check.disagree],
        "poses": check.solution.poses,
        "chi2_per_dof": check.chi2.per_dof,
        "chi2_band_99": [check.chi2.low, check.chi2.high],
        "parameters": {
            d.name: change_data(d, "closed_loop", "open_loop") | {"significant": d.significant}
            for d in check.differences
        },
        "not_compared": list(check.left_out),
        "reasons": list(check.solution.reasons),
    }


def open_loop_text(check: OpenLoopCheck, folder: str) -> str:
    """Return the open-loop check as text for a terminal of 80 columns, the verdict first."""
    poses, verdict = check.solution.poses, _verdict(check)
    if verdict == UNSOUND:
        head = (
            f"NO CONCLUSION: the {poses} measured poses give no sound calibration of the open arm "
            f"({'; '.join(check.solution.reasons)}). Check the instrument, its target and the "
            "accuracy stated in its file."
        )
    elif verdict == AGREES:
        head = (
            f"AGREES: {poses} poses of the open arm, measured by another instrument, agree with the "
            f"calibration of {folder} on the arm."
        )
    elif check.disagree:
        names = ", ".join(d.name for d in check.disagree)
        head = (
            f"DISAGREES: {poses} poses of the open arm disagree with the calibration of "
            f"{folder} of {names}. Check whether a joint slipped in between, and whether the hinge or the "
            "target on the tool is loose. Calibrate again; a remaining difference is an error in a file."
        )
    else:
        head = (
            f"DISAGREES: {poses} poses of the open arm differ from the calibration of {folder} by more "
            "than its uncertainty allows, but no single parameter does."
        )
    per_dof, most = (CHI2(v).shown for v in (check.chi2.per_dof, check.chi2.high))
    note = (
        f"Change = open - closed. * marks a difference that any of {len(check.differences)} parameters has by chance "
        f"in {100.0 * DRIFT_FALSE_ALARM_PROBABILITY:g} % of checks. All differences together: chi2/dof {per_dof}; by "
        f"chance at most {most} in 99 % of checks."
    )
    lines = [paragraph(head), "", *table_lines(_table(check)), paragraph(note)]
    if check.left_out:
        lines.append(paragraph(f"Not compared, remounted: {', '.join(check.left_out)}."))
    return "\n".join(lines)


def _verdict(check: OpenLoopCheck) -> str:
    if not check.solution.accepted:
        return UNSOUND
    return AGREES if check.holds else DISAGREES


def _table(check: OpenLoopCheck) -> FactTable:
    titles = ("closed loop", "open loop", "change", "sigma")
    columns = (*words("parameter", "unit"), *figures(*titles), *words(""))
    changes = change_cells(check.differences)
    rows = tuple((*cells, "*" if d.significant else "") for d, cells in changes)
    return FactTable(ident="open_loop", title="", columns=columns, rows=rows)
