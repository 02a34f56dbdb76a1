"""New poses judged by a calibration, as text and as JSON. Computes nothing, prints nothing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from operator_app.calibration.prediction import FIXTURE, shift_in_words
from operator_app.report.quality_tables import CLOSURE_COLUMNS, closure_row
from operator_app.report.table import FactTable, keyed
from operator_app.report.text import paragraph, table_text
from operator_app.units.figure import ANGLE, CHI2, SIGMA_ORI, SIGMA_POS
from operator_app.units.numbers import significant

if TYPE_CHECKING:
    from operator_app.calibration.verification import VerificationResult
    from operator_app.session.ui.snapshot import Verified
    from solver.chain.poses import PoseSet
    from solver.diagnostics.prediction import CommonShift

WORST = 5
"""Odd poses that are named."""


def closure(verdict: VerificationResult) -> FactTable:
    """Closure of the new poses at the nominal parameters and at those that are judged."""
    return FactTable(
        ident="closure",
        title="Closure at the measured joints",
        columns=CLOSURE_COLUMNS,
        rows=(
            closure_row("nominal", verdict.nominal, key=("nominal",)),
            closure_row("calibrated", verdict.verification.sigmas, key=()),
        ),
    )


def verification_json(verdict: VerificationResult, poses: PoseSet) -> dict[str, Any]:
    """Return the object of `sarcal verify --json`."""
    chi2, shift = verdict.verification.chi2, verdict.shift
    return {
        "verdict": "holds" if verdict.holds else "does not hold",
        "poses": verdict.poses,
        "chi2_per_dof": chi2.per_dof,
        "chi2_band_99": [chi2.low, chi2.high],
        **keyed((closure(verdict),)),
        "odd_poses": [poses.label[k] for k in verdict.odd_poses],
        "shift": None if shift is None else _shift_json(shift),
    }


def _shift_json(shift: CommonShift) -> dict[str, Any]:
    """Return what has shifted: ``joint_4``, by deg, or ``fixture``."""
    joint = shift.subject != FIXTURE
    return {
        "what": f"joint_{shift.subject}" if joint else shift.subject,
        "size_deg": None if shift.size is None or not joint else shift.size * ANGLE.json_per_si,
        "sigma_deg": None if shift.sigma is None or not joint else shift.sigma * ANGLE.json_per_si,
        "chi2": shift.chi2,
        "threshold": shift.threshold,
        "text": shift_in_words(shift),
    }


def verification_text(verdict: VerificationResult, poses: PoseSet, folder: str) -> str:
    """Return everything worth knowing, the verdict first, for a terminal of 80 columns."""
    found = verdict.verification
    per_dof, most = (CHI2(v).shown for v in (found.chi2.per_dof, found.chi2.high))
    head = (
        f"HOLDS: the calibration of {folder} predicts these {verdict.poses} poses as well as it "
        "claims to."
        if verdict.holds
        else f"DOES NOT HOLD: {verdict.poses} new poses disagree with the calibration of {folder} "
        "by more than its uncertainty allows."
    )
    notices = []
    if verdict.shift is not None:
        notices.append(shift_in_words(verdict.shift))
    if verdict.odd_poses:
        worst = ", ".join(
            f"{poses.label[k]} (chance {significant(float(found.pose_probability[k]), 2)})"
            for k in verdict.odd_poses[:WORST]
        )
        notices.append(f"look at pose {worst}")
    if not verdict.holds and not np.all(found.closed):
        notices.append(
            "some poses cannot be closed at all: was the fixture moved since, or has their placement the "
            "number of another one?"
        )
    return "\n".join(
        (
            paragraph(head),
            "",
            table_text(closure(verdict)),
            # What files state enters as prior, as the most that is allowed: less is no news.
            paragraph(
                f"chi2/dof {per_dof}: 1 or less when all is as stated; above {most} is one sound set in 200 at most."
            ),
            *(paragraph(f"! {notice}", indent=2) for notice in notices),
        )
    )


def verified_words(found: Verified) -> str:
    """Say what new poses said: whether the parameters hold, before the figures."""
    ratio = CHI2(found.chi2_per_dof).shown
    turned = found.orientation_rad
    return (
        f"{found.poses} new poses, {found.verdict}: {SIGMA_POS(found.position_m).with_unit}"
        f"{'' if turned is None else f', {SIGMA_ORI(turned).with_unit}'} rms, chi2/dof {ratio}"
    )
