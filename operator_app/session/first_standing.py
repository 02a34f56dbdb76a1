"""May what the joints read be true, where the arm stands? Asked before the drives of an arm without poses are enabled.

The hand is held, so the loop has to close where the arm stands, within what the files leave open. A counter
that began anew, a direction that is wrong, or joints in another order: with such readings it does not, and
what is driven by them goes where nobody meant it to go. Knows no bus and no screen; refuses in words.
"""

from __future__ import annotations

import numpy as np

from hardware.arm import Reading
from operator_app.calibration.standing import StandingFit, StandingLoop, standing_loop
from operator_app.config.procedure import Procedure
from operator_app.errors import GuardError
from operator_app.units.figure import REACH
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.sensors import Encoder

AT_ZERO_COUNTS = 2.5
"""A counter that has just begun anew, and the noise of its last bit."""

IMPROBABLE = 1e-12
"""Chance of refusing an arm that is as its files state, their tolerances being three standard deviations.

So small, as arms are about whose files are wrong in everything: offsets off by 25 deg, hinges by 40 mm and 15 deg.
"""

IMPROBABLE_AT_ZERO = 1e-2
"""The same where a counter stands at zero: by chance one stands there in one of 30,000 places."""

EXPECTED_AT_ZERO_RAD = float(np.deg2rad(5.0))
"""A joint whose home is as near to zero as this stands there often."""

EXPLAINS = 1e-2
"""Chance of what is left, above which a joint alone explains why the loop does not close."""

AT_MOST_NAMED = 3


def at_zero(arm: ArmModel, counts: FloatArray) -> tuple[int, ...]:
    """Joints (1-based) whose counter stands at zero."""
    return tuple(
        j
        for j, (joint, count) in enumerate(zip(arm.joints, counts, strict=True), 1)
        if isinstance(joint.sensor, Encoder) and abs(count) <= AT_ZERO_COUNTS
    )


def check_first_standing(procedure: Procedure, reading: Reading) -> None:
    """Refuse readings with which the loop cannot close where the arm stands.

    Raises
    ------
    GuardError
        Names the joint that alone would close it, if there is one.
    """
    if not procedure.fixture.fixture.holds_hand:
        return
    arm = procedure.arm
    loop = standing_loop(
        arm, procedure.fixture.fixture, reading.mean_rad, unsensed_joints=procedure.unsensed_joints
    )
    found = loop.fit()
    chance = _chance(found)
    if chance >= IMPROBABLE_AT_ZERO:
        return
    zeros = [
        j
        for j in at_zero(arm, reading.mean_counts)
        if j in loop.joints and abs(arm.home_rad[j - 1]) > EXPECTED_AT_ZERO_RAD
    ]
    if chance >= IMPROBABLE and not zeros:
        return
    alone = _alone(loop)
    begun_anew = [j for j in zeros if j in alone]
    if begun_anew:
        joint = begun_anew[0]
        raise GuardError(
            f"the counter of joint {joint} stands at zero, and with it the loop does not close where the arm "
            f"stands: it would with that joint near {_near(alone[joint], joint)}. Its counter began anew, as "
            "after a loss of power",
            f"home joint {joint}, then connect again; moved by this reading it would go elsewhere",
        )
    if chance >= IMPROBABLE:
        return
    raise GuardError(_does_not_close(alone), _remedy(alone))


def _does_not_close(alone: dict[int, StandingFit]) -> str:
    said = "the loop cannot close where the arm stands, with these readings and all that the files leave open"
    if not alone:
        return f"{said}, whichever joint's reading is left out"
    joints = list(alone)[:AT_MOST_NAMED]
    would = " or ".join(f"joint {j} near {_near(alone[j], j)}" for j in joints)
    return f"{said}; it would with {would}"


def _remedy(alone: dict[int, StandingFit]) -> str:
    likeliest = next(iter(alone), None)
    what = (
        "the zeros, directions and order of the joints"
        if likeliest is None
        else f"the zero of joint {likeliest} (a counter that began anew) and its direction, first"
    )
    return (
        f"move nothing by these readings. Look at {what}; then at the profile, at whether this fixture's file "
        "is the right one, and at whether it holds the hand. Where offsets or placement are less well known "
        "than within 10 deg and the fixture's tolerance, state it: offset_tolerance_deg in the arm file, "
        "tolerance_mm and tolerance_deg in the fixture's"
    )


def _near(fit: StandingFit, joint: int) -> str:
    return REACH(float(fit.q_rad[joint - 1])).with_unit


def _alone(loop: StandingLoop) -> dict[int, StandingFit]:
    """Joints that alone explain it, the likeliest first."""
    fits = {j: loop.fit(j) for j in loop.joints}
    explain = {j: f for j, f in fits.items() if _chance(f) >= EXPLAINS}
    return dict(sorted(explain.items(), key=lambda item: item[1].chi2))


def _chance(found: StandingFit) -> float:
    from scipy.special import chdtrc

    return float(chdtrc(found.dof, found.chi2)) if np.isfinite(found.chi2) else 0.0
