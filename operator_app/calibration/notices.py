"""What an operator should know of a calibration: notices in plain words, and reasons against it.

Every sentence says what to do where there is something to do. Knows results; computes no estimate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import radians

from fixtures.base import Fixture, SetupCheck, Severity
from operator_app.calibration.causes import NamedCause, Words, poses_named
from operator_app.calibration.distances import Distance
from operator_app.calibration.placements import IndistinguishablePlacements
from operator_app.calibration.tool_accuracy import HandAccuracy
from operator_app.config.procedure import AcceptanceLimits
from operator_app.units.figure import (
    ANGLE_TOLERANCE,
    CHI2,
    CLOSURE_LENGTH,
    CONDITION,
    LENGTH_TOLERANCE,
    NOMINAL_OFFSET,
    ORI_LIMIT,
    POS_LIMIT,
    READING,
    SPAN,
    Figure,
    quantity_of,
)
from operator_app.units.numbers import significant
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.diagnostics.identifiability import Identifiability
from solver.diagnostics.limits import CHI2_NOTICE_PROBABILITY
from solver.diagnostics.range_checks import RangeFinding, ReadingFault
from solver.diagnostics.rvdt import RvdtVerdict
from solver.estimators.estimate import Estimate
from solver.estimators.variance_components import VarianceComponents
from solver.search.global_start import GlobalStart


@dataclass(frozen=True, slots=True, kw_only=True)
class Notice:
    """Something the operator should know: a stable code and a sentence."""

    code: str
    text: str


def setup_notices(checks: tuple[SetupCheck, ...]) -> tuple[Notice, ...]:
    """Say what the fixture's set-up checks warn of at the identified parameters."""
    return tuple(
        Notice(code=c.code, text=f"{c.text}: {c.remedy}")
        for c in checks
        if c.severity is not Severity.OK and not c.code.startswith("HIDDEN")
    )


def distance_notices(contradicted: tuple[Distance, ...]) -> tuple[Notice, ...]:
    """Say which measured distances of sockets the poses contradict."""
    return tuple(
        Notice(
            code="DISTANCE",
            text=f"the distance of sockets {d.between[0]} and {d.between[1]} in the fixture's file is "
            f"{abs(d.deviation):.1f} sigma {'above' if d.deviation > 0.0 else 'below'} what the poses say: measure "
            "it again and correct distance there; the arm's lengths are scaled by it",
        )
        for d in contradicted
    )


def endpoint_notices(fixture: Fixture, poses: PoseSet) -> tuple[Notice, ...]:
    """Say that measured endpoints took no part, where the fixture is no instrument."""
    if poses.endpoint is None or fixture.kind == "measured":
        return ()
    text = (
        f"the poses have measured endpoints (x_m,y_m,z_m), which a {fixture.kind} knows nothing of: they took no "
        "part; calibrate with a measured fixture, or judge by them with sarcal verify --open-loop"
    )
    return (Notice(code="ENDPOINTS_UNUSED", text=text),)


def range_notices(
    findings: tuple[RangeFinding, ...], labels: tuple[str, ...]
) -> tuple[Notice, ...]:
    """Say which readings the arm file does not allow, and what to do about it."""
    return tuple(Notice(code="RANGE", text=": ".join(range_text(f, labels))) for f in findings)


def range_text(found: RangeFinding, labels: tuple[str, ...]) -> tuple[str, str]:
    """Say of one joint what its readings have wrong, and what to do."""
    where = poses_named(found.poses, labels)
    reading = f"joint {found.joint} reads {READING(found.reading_rad).with_unit} in {where}"
    span = f"{SPAN(found.lower_rad).shown} to {SPAN(found.upper_rad).with_unit}"
    if found.fault is ReadingFault.SATURATED:
        return (
            f"{reading}, the end of its sensor's full scale ({span}): beyond it every angle reads so",
            "take these poses nearer the middle of the sensor's range, or leave them out",
        )
    if found.fault is ReadingFault.WHOLE_TURN:
        return (
            f"{reading}, whole turns from its range {span}: its encoder counts from another turn",
            "home the joint or correct range_deg in the arm file",
        )
    return (
        f"{reading}, outside its range {span}",
        "look for a damaged reading, or correct range_deg in the arm file",
    )


def noise_notices(chi2: float, dof: int) -> tuple[Notice, ...]:
    """Say so when noise as the files state it cannot have left this misfit: `chi2` is at stated variances."""
    from scipy.special import chdtrc

    if dof <= 0 or float(chdtrc(dof, chi2)) >= CHI2_NOTICE_PROBABILITY:
        return ()
    return (
        Notice(
            code="CHI2",
            text=f"chi2/dof at stated noise is {CHI2(chi2 / dof).shown} where 1 is the most that is expected: "
            "something is worse than its file states; the sigmas count in what was found of it, the "
            "causes and the sources of error say what it may be",
        ),
    )


ASTRAY = Notice(
    code="ASTRAY",
    text="what refuses this calibration has led it where no file would have the arm, or left it known to "
    "nobody's use: none of its figures says anything of the arm or the fixture, and no advice is drawn from "
    "them. Mend the cause that comes first and calibrate again",
)


def held_notices(held: tuple[str, ...], accuracy: HandAccuracy) -> tuple[Notice, ...]:
    """Say what was dropped on request."""
    if not held:
        return ()
    return (
        Notice(
            code="HELD",
            text=f"{', '.join(held)} cannot be seen in these poses and "
            f"{'was' if len(held) == 1 else 'were'} held at nominal values"
            f"{held_in_words(accuracy)}",
        ),
    )


def not_sought_notices(
    joints: tuple[int, ...], accuracy: HandAccuracy, arm: ArmModel
) -> tuple[Notice, ...]:
    """Say which offsets were not looked for, by the procedure or the arm's file, and what that means."""
    if not joints:
        return ()
    values = {f"theta_off_{j}": float(arm.table.theta_off_rad[j - 1]) for j in joints}
    at = ", ".join(f"{n} at {NOMINAL_OFFSET(v).with_unit}" for n, v in values.items())
    words = f"not calibrated but held, as the arm's file has it: {at}"
    if arm.offset_tolerance_rad is not None:
        size = ANGLE_TOLERANCE(arm.offset_tolerance_rad).with_unit
        words += f"; known within {size}, which the hand's accuracy counts in"
    return (Notice(code="HELD", text=words + held_in_words(accuracy)),)


def held_in_words(accuracy: HandAccuracy) -> str:
    """What the hand's accuracy does not count in, as a sentence after another; empty where there is nothing."""
    if not accuracy.holds_for:
        return ""
    names = ", ".join(h.name for h in accuracy.holds_for)
    rates = ", ".join(
        f"{Figure(h.rate_m_per_rad * radians(1.0), CLOSURE_LENGTH).with_unit} rms for each degree of {h.name}"
        for h in accuracy.holds_for
    )
    return (
        f". No file states how well {names} is known: what is said of the hand's accuracy holds only if the value "
        f"held is right, and otherwise the hand is off by {rates} as well. Calibrate it in a fixture that shows it, "
        "or state offset_tolerance_deg in the arm's file"
    )


def held_in_short(accuracy: HandAccuracy) -> str:
    """The same beside a figure of the hand's accuracy, for whoever reads the notice as well."""
    names = " and ".join(h.name for h in accuracy.holds_for)
    return f". It holds only if {names} is held at what it is: see the warnings" if names else ""


def as_stated_notices(
    by_files: tuple[str, ...], estimate: Estimate, shares: Mapping[str, float]
) -> tuple[Notice, ...]:
    """Say of which parameters the poses bring less than the files, and how well these tell them."""
    said = []
    for name in by_files:
        share = f"{name}: {100.0 * shares.get(name, 0.0):.0f} % from these poses"
        names = [p.name for p in estimate.parameters]
        if name in names:
            k = names.index(name)
            kind = ANGLE_TOLERANCE if estimate.parameters[k].is_angle else LENGTH_TOLERANCE
            size = kind(float(estimate.standard_deviation[k]))
            share += f", sigma {size.with_unit}"
        said.append(share)
    if not said:
        return ()
    text = f"known by the files rather than by the poses: {'; '.join(said)}"
    return (Notice(code="AS_STATED", text=text),)


def rival_notices(found: GlobalStart | None) -> tuple[Notice, ...]:
    """Say that the poses cannot decide between solutions."""
    if found is None or not found.rivals:
        return ()
    return (
        Notice(
            code="SECOND_SOLUTION",
            text=f"{len(found.rivals)} distinct solution{'s fit' if len(found.rivals) > 1 else ' fits'}"
            " these poses as well: take more poses that differ, or give nominal values nearer the truth",
        ),
    )


def left_out_notices(found: tuple[Words, ...]) -> tuple[Notice, ...]:
    """Name the poses left out, for whatever reason."""
    return tuple(Notice(code=w.code, text=f"{w.text}: {w.remedy}") for w in found)


def flexure_notices(
    components: VarianceComponents | None, tolerated: tuple[str, ...]
) -> tuple[Notice, ...]:
    """Say that what passes for a fixture that gives may be link lengths that are off."""
    if components is None or tolerated:
        return ()
    if components.flexure is None or not components.flexure.gives:
        return ()
    return (
        Notice(
            code="LENGTHS_EXACT",
            text="the loops close only with a fixture that gives, and link lengths were taken as "
            "exact; if the maker's lengths are not, the sigmas are too small: calibrate again with "
            "--length-tolerance 1.5 (mm) and compare",
        ),
    )


def indistinguishable_notices(found: tuple[IndistinguishablePlacements, ...]) -> tuple[Notice, ...]:
    """Say which placements are one and the same: whoever took them believes to know more than that."""
    return tuple(_alike_notice(a) for a in found)


def _alike_notice(found: IndistinguishablePlacements) -> Notice:
    *first, last = map(str, found.numbers)
    size = Figure(found.difference, quantity_of(found.parameter), digits=2).with_unit
    return Notice(
        code="SAME_PLACEMENT",
        text=f"placements {', '.join(first)} and {last} of the fixture are the same within their sigmas "
        f"({found.parameter.name} differs most: by {size}, {significant(found.sigmas, 2)} sigma): it was not "
        "mounted anew between them, or is exactly where it was, and they tell no more than one placement with all "
        "their poses does. Mount it elsewhere within its tolerance and take another placement",
    )


def outlier_notices(labels: tuple[str, ...]) -> tuple[Notice, ...]:
    """Name poses that do not fit the others; nothing is left out silently."""
    if not labels:
        return ()
    several = len(labels) > 1
    return (
        Notice(
            code="OUTLIER",
            text=f"{poses_named(tuple(range(len(labels))), labels)} "
            f"{'do' if several else 'does'} not fit the others and still "
            f"{'count' if several else 'counts'}: look for what disturbed "
            f"{'them' if several else 'it'}, then exclude {'them' if several else 'it'} or not",
        ),
    )


def rvdt_notices(verdicts: tuple[RvdtVerdict, ...]) -> tuple[Notice, ...]:
    """Say what the loops say of each RVDT."""
    return tuple(Notice(code=f"RVDT_{v.joint}", text=v.text) for v in verdicts)


SAID = ("OUTLIERS", "FLIPPED", "SECOND_SOLUTION", "RANGE", "SATURATED", "PARALLEL", "RVDT")
"""Causes of which there is a notice of their own, or that name the RVDT a notice is about."""


def cause_notices(causes: Iterable[NamedCause]) -> tuple[Notice, ...]:
    """Say what is out of order though the sigmas hold."""
    return tuple(
        Notice(code=c.code, text=f"{c.text}: {c.remedy}")
        for c in causes
        if not c.refuses and not c.code.startswith(SAID)
    )


def condition_notices(seen: Identifiability, limits: AcceptanceLimits) -> tuple[Notice, ...]:
    """Say that the paper would not have called these poses well conditioned; the sigmas decide."""
    if seen.scaled_condition_number <= limits.scaled_condition_number:
        return ()
    return (
        Notice(
            code="CONDITION",
            text=f"scaled condition number {CONDITION(seen.scaled_condition_number).shown} is above "
            f"{CONDITION(limits.scaled_condition_number).shown} (the weakest direction is "
            f"{', '.join(seen.weakest.parameters[:4])}): poses that differ more would give smaller "
            "sigmas",
        ),
    )


def reasons_against(estimate: Estimate, limits: AcceptanceLimits) -> tuple[str, ...]:
    """Say which of the procedure's own limits a calibration exceeds; empty when none."""
    reasons = []
    after, turned = estimate.sigmas, estimate.sigmas.orientation_rad
    for symbol, found, limit, kind in (
        ("sigma_pos", after.position_m.rms, limits.sigma_pos_m, POS_LIMIT),
        ("sigma_ori", None if turned is None else turned.rms, limits.sigma_ori_rad, ORI_LIMIT),
    ):
        if limit is not None and found is not None and found > limit:
            reasons.append(f"{symbol} {kind(found).with_unit} is above {kind(limit).with_unit}")
    ratio, most = estimate.chi2_per_dof, limits.chi2_per_dof
    if ratio is not None and most is not None and ratio > most:
        reasons.append(
            f"chi2/dof {CHI2(ratio).shown} is above {CHI2(most).shown}: these readings do not fit the sensors' "
            "and the fixture's specifications; take more poses, look for a pose that was "
            "disturbed, or leave out the joint that the warnings name"
        )
    return tuple(reasons)
