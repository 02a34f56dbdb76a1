"""Alternative models for a gross misfit: solves the most promising and returns their probabilities.

Used if no fault in the linear model accounts for the misfit, or if the solution is implausible.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from itertools import chain, combinations, product
from time import thread_time

import numpy as np

from fixtures.ball import Ball
from fixtures.measured import Measured
from operator_app.calibration.alternative_model import (
    Alternative,
    closes,
    cost_of,
    fitted,
    hinge_instead,
    is_near,
    other_fixtures,
    shift_of,
    solved,
    start,
    tried,
    without_reading,
    without_readings,
)
from operator_app.calibration.error_model import stated_distances
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.findings import pose_labels, reading_step, sensor_name
from operator_app.calibration.instrument_registration import with_registered_instrument
from operator_app.calibration.placements import compared, contradiction, distances
from operator_app.messages.finding import Finding, FindingKind
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector, wrap_angles
from solver.chain.poses import PoseSet
from solver.diagnostics import limits
from solver.diagnostics.fault_models import constant_reading_runs
from solver.diagnostics.hypothesis_tests import HypothesisTest
from solver.diagnostics.model_selection import probabilities
from solver.diagnostics.range_checks import Mistake, mistakes, mostly_in_range
from solver.diagnostics.statistics import sigmas_at
from solver.estimators.estimate import Estimate, closure_at_readings
from solver.estimators.linear_fit import LinearFit

PROMISING_COST_SHARE = 0.3
"""An alternative is solved completely if its squared closure error is below this share of the stated model's."""

PER_FREEDOM = 4.6
"""Reduction (ln 100) of an alternative's log weight for each degree of freedom that the stated model has in excess."""

LEAST_M = 2e-3
"""Two lengths that differ by less than this count as equal."""

LEAST_CHANGE_RAD = np.deg2rad(0.05)
"""The arm file's offsets are tried as radians only if the largest exceeds this; smaller ones are zero in any unit."""

LARGEST_IN_RADIANS = np.deg2rad(2.0 * np.pi)
"""A reading of one turn, in rad, if the file has it in radians and it was read as degrees: 2 pi deg."""

LARGEST_OFFSET_RAD = np.deg2rad(10.0)
"""A joint's zero counts as wrong by a quarter or half turn if its error differs from such a turn by less than this."""

MOST_LEFT_OUT = 3
"""Largest number of poses left out to explain a gross misfit; also at most a tenth of all poses."""

SOLVED_ALTERNATIVES = 3
"""Number of the most promising alternatives that are solved completely."""

LONGEST_S = 4.0
"""Limit of the search's CPU time in this thread, s; time used by other programs does not count."""


def find_alternatives(
    stated: Experiment,
    *,
    scale: float,
    dof: int,
    near: bool = False,
    of_files: bool = False,
    sensors: bool = False,
) -> tuple[Finding, ...]:
    """Return the mistakes that explain a gross misfit of the stated model, the most probable first.

    `scale`: chi2/dof of the stated model at stated variances; infinite without a solution. `dof`: the model's dof.
    `of_files`: try only simple mistakes in the poses or arm file.
    `near`: like `of_files`, but keep only mistakes whose correction brings the solution near the nominal values. Such
    mistakes are found even if the stated model fits well.
    `sensors`: with `near`, also try a sensor whose readings are useless in all poses.
    """
    deadline = thread_time() + LONGEST_S
    as_it_is = np.inf if near or stated.unsensed else cost_of(stated)
    weighted: list[tuple[Finding, float]] = []
    fits: list[Experiment] = []
    blind, same_loop = _without_each_reading(stated), _same_loop(stated)
    if near or of_files:
        families: list[Iterable[Alternative]] = [same_loop, *([blind] if sensors else [])]
    else:
        elsewhere = chain(other_fixtures(replace(stated, unsensed=())), blind)
        families = [_frozen(stated), _without_worst(stated), same_loop, elsewhere]
    for family in families:
        closest = _closest(family, deadline, below=PROMISING_COST_SHARE * as_it_is)
        # The fixture may also be far from its stated placement: tried only if no mistake alone explains the misfit.
        for anywhere in (False, True) if family is same_loop else (False,):
            for finding, alternative in closest if not weighted else ():
                if near and not is_near(alternative):
                    continue
                if thread_time() > deadline:
                    break
                ratio, dof_left = solved(alternative, anywhere=anywhere)
                if alternative.fixture is not stated.fixture and closes(alternative, far=as_it_is):
                    # Loops never close this well by chance: the fixture is not excluded even if chi2/dof is too large.
                    ratio = min(ratio, 0.99 * limits.CHI2_PER_DOF_ALTERNATIVE)
                if ratio < limits.CHI2_PER_DOF_ALTERNATIVE and (
                    near or limits.ALTERNATIVE_CHI2_RATIO * ratio < scale
                ):
                    weighted.append((finding, _weight(ratio, dof_left, dof)))
                    fits.append(alternative)
        if weighted:
            break
    weighted += [
        (finding, _weight(ratio, dof_left, dof))
        for alternative in fits
        for finding, ratio, dof_left in _shifted(alternative, stated.unsensed)
        if ratio < limits.CHI2_PER_DOF_ALTERNATIVE
    ]
    if not weighted and np.isfinite(as_it_is) and not of_files:
        # A fit without a sensor may end at another solution: loops that nearly close suffice.
        weighted = [
            (finding, 0.0)
            for finding, alternative in _frozen_in_all_poses(stated)
            if cost_of(alternative) <= PROMISING_COST_SHARE * as_it_is
        ]
    return _named(weighted)


def poses_in_radians(stated: Experiment, scale: float) -> tuple[Finding, ...]:
    """Return the finding that all readings are in radians, if the joints' ranges allow it and the fit is far better.

    `scale`: finite chi2/dof of the stated model. `find_alternatives` does not find this mistake: angles in radians,
    read as degrees, hardly differ between poses, so that even the uncorrected loops close with small errors.
    """
    q_rad = stated.poses.q_rad
    mistake = next(mistakes(stated.arm, q_rad))
    if np.abs(q_rad).max() > LARGEST_IN_RADIANS or not mostly_in_range(stated.arm, mistake.q_rad):
        return ()
    finding, alternative = _corrected(stated, mistake)
    ratio, _ = solved(_refitted(alternative, alternative.poses), anywhere=True)
    # Readings out of range as degrees are wrong in any case: a better fit suffices.
    times = limits.ALTERNATIVE_CHI2_RATIO if mostly_in_range(stated.arm, q_rad) else 1.0
    return _named([(finding, 0.0)]) if times * ratio < scale else ()


def hinge_alternative(stated: Experiment) -> tuple[Finding, ...]:
    """Return the finding that the fixture is a hinge, not the ball that the file states; empty if no hinge fits.

    Poses in a hinge do not determine a ball: they fit a ball with its centre anywhere on the hinge's axis.
    """
    if not isinstance(stated.fixture, Ball) or len(stated.poses) < limits.ALTERNATIVE_FIXTURE_POSES:
        return ()
    finding, alternative = hinge_instead(stated)
    fits = solved(alternative)[0] < limits.CHI2_PER_DOF_ALTERNATIVE
    return _named([(finding, 0.0)]) if fits else ()


def wrong_distances(
    stated: Experiment, fit: LinearFit, *, most_chi2: float, again: bool = True
) -> tuple[Finding, ...]:
    """Return findings of wrong measured socket distances; empty if leaving out distances does not make the poses fit.

    The distances that deviate most are left out one after the other until the rest fits: chi2 passes its test at the
    stated variances, and is at most `most_chi2` at the variances of `fit.at_known_noise`. `again`: whether to solve the
    loops again without these distances if the linear `fit` does not pass; the effects of large errors are not linear.
    """
    fit_stated = fit.stated
    known = compared(stated, fit_stated)
    limit = sigmas_at(limits.DISTANCE_NOTICE_PROBABILITY, len(known))
    order = sorted(range(len(known)), key=lambda k: -abs(known[k][1]))[:SOLVED_ALTERNATIVES]
    alternative = stated
    for count, k in enumerate(order, 1):
        distance, deviation = known[k]
        if abs(deviation) <= limit or not isinstance(alternative.fixture, Ball):
            break
        others = tuple(d for d in alternative.fixture.distances if d is not distance)
        alternative = replace(alternative, fixture=replace(alternative.fixture, distances=others))
        chosen = np.array(order[:count])
        fits = fit.at_known_noise.chi2_without_distances(chosen) <= most_chi2 and _as_stated(
            fit_stated.chi2_without_distances(chosen), fit_stated.dof - count
        )
        if again and not fits:
            ratio, dof = solved(alternative, anywhere=True)
            fits = ratio * dof <= most_chi2 and _as_stated(ratio * dof, dof)
        if fits:
            findings = [contradiction(known[c][0].between, known[c][1]) for c in order[:count]]
            return tuple(replace(finding, blocking=True) for finding in findings)
    return ()


def refuted_distances(stated: Experiment) -> tuple[Finding, ...]:
    """Fit the poses without any measured socket distance; return findings of the distances that the fit contradicts.

    Use this for distances so wrong that a fit with them has no meaning. The loops are solved from the nominal values.
    """
    known = [(d, 0.0) for d in stated_distances(stated)]
    if not known or not isinstance(stated.fixture, Ball):
        return ()
    alone = replace(stated, fixture=replace(stated.fixture, distances=()))
    found = tried(lambda: fitted(alone, anywhere=True), None)
    if found is None or not _as_stated(found.fit.chi2, found.fit.dof):
        return ()
    fit, x, placements = found.fit, found.x, stated.poses.placements
    limit = sigmas_at(limits.DISTANCE_NOTICE_PROBABILITY, len(known))
    findings = []
    for distance in distances(fit.design.model, x, fit.covariance, placements, known):
        if (measured := distance.measured) is not None:
            sigma = np.hypot(measured.sigma_m, distance.sigma_m)
            deviation = (measured.value_m - distance.value_m) / sigma
            if abs(deviation) > limit:
                findings.append(contradiction(measured.between, float(deviation)))
    findings.sort(key=lambda f: -f.figures["sigmas"])
    return tuple(replace(finding, blocking=True) for finding in findings)


def _as_stated(chi2: float, dof: int) -> bool:
    return dof > 0 and not HypothesisTest.of_chi2("CHI2_STATED", chi2, dof).fires


def step_alternative(stated: Experiment, joint: int, scale: float) -> tuple[Finding, ...]:
    """Return the finding of a step that explains a joint's wrong readings; `scale`: chi2/dof of the stated model."""
    shifted = _shifted(without_reading(stated, joint), stated.unsensed)
    return _named(
        [
            (finding, 0.0)
            for finding, ratio, _ in shifted
            if ratio < limits.CHI2_PER_DOF_ALTERNATIVE
            and limits.ALTERNATIVE_CHI2_RATIO * ratio < scale
        ]
    )


def _weight(ratio: float, dof_left: int, dof: int) -> float:
    """Return an alternative's log weight; `ratio`: its chi2/dof, `dof_left`: its dof, `dof`: the stated model's dof."""
    fits = -0.5 * dof * np.log(max(ratio, limits.SMALLEST_NOISE_SCALE))
    return float(fits - PER_FREEDOM * max(0, dof - dof_left))


def _named(weighted: list[tuple[Finding, float]]) -> tuple[Finding, ...]:
    if not weighted:
        return ()
    chance = probabilities(np.array([weight for _, weight in weighted]))
    order = np.argsort(-chance)
    return tuple(
        replace(weighted[k][0], probability=float(chance[k]), blocking=True)
        for k in order
        if chance[k] > 0.02
    )


def _same_loop(stated: Experiment) -> Iterator[Alternative]:
    """Yield alternatives with one mistake in the poses or arm file corrected: unit, sign, zero, exchanged values."""
    if stated.unsensed:
        return
    arm, poses = stated.arm, stated.poses
    for mistake in mistakes(arm, poses.q_rad):
        if mostly_in_range(arm, mistake.q_rad):
            yield _corrected(stated, mistake)
    offsets = arm.table.theta_off_rad
    if LEAST_CHANGE_RAD < float(np.abs(offsets).max()) < np.deg2rad(2.0 * np.pi):
        meant = _with_table(arm, theta_off_rad=offsets / np.deg2rad(1.0))
        yield Finding(FindingKind.OFFSETS_IN_RADIANS), replace(stated, arm=meant)
    for joint, turn in product(range(1, arm.joint_count + 1), (0.5 * np.pi, -0.5 * np.pi, np.pi)):
        yield _turned(stated, joint, turn)
    if poses.endpoint is not None and isinstance(stated.fixture, Measured):
        yield from (_other_rows(stated, poses.endpoint, rows) for rows in (1, -1))
    for kind in ("s", "a"):
        lengths = getattr(arm.table, f"{kind}_m")
        for i, j in combinations(np.flatnonzero(np.abs(lengths) > LEAST_M), 2):
            if abs(lengths[i] - lengths[j]) > LEAST_M:
                order = np.arange(len(lengths))
                order[[i, j]] = j, i
                entries = (f"{kind}_{i + 1}", f"{kind}_{j + 1}")
                finding = Finding(FindingKind.ENTRIES_EXCHANGED, names=entries)
                exchanged = _with_table(arm, **{f"{kind}_m": lengths[order]})
                yield finding, replace(stated, arm=exchanged)


def _corrected(stated: Experiment, mistake: Mistake) -> Alternative:
    finding = Finding(
        FindingKind.READING_MISTAKE, names=(mistake.code,), reported=(mistake.text, mistake.remedy)
    )
    return finding, replace(stated, poses=replace(stated.poses, q_rad=mistake.q_rad))


def _without_worst(stated: Experiment) -> Iterator[Alternative]:
    """Yield alternatives with one pose after another left out: each time, the pose with the largest closure error."""
    labels, kept, rest = pose_labels(stated.poses), np.arange(len(stated.poses)), stated
    left_out: list[str] = []
    while not stated.unsensed and len(left_out) < min(MOST_LEFT_OUT, len(labels) // 10):
        if (found := tried(partial(start, rest), None)) is None:
            return
        residual = closure_at_readings(rest.loop(), found[0], rest.poses.q_rad).residual
        worst = int(np.argmax((residual**2).sum(-1)))
        left_out.append(labels[kept[worst]])
        kept = np.delete(kept, worst)
        rest = _refitted(stated, stated.poses.at_poses(kept))
        yield Finding(FindingKind.OUTLIERS, poses=tuple(left_out)), rest


def _refitted(stated: Experiment, poses: PoseSet) -> Experiment:
    """Return the experiment with `poses`; instrument placements that no file states are estimated from these poses."""
    fixture = with_registered_instrument(stated.arm, stated.fixture, poses)
    return replace(stated, poses=poses, fixture=fixture)


def _other_rows(stated: Experiment, endpoint: FloatArray, rows: int) -> Alternative:
    """Return the alternative in which each pose gets the endpoint that is `rows` rows further down in the file."""
    kept = np.arange(max(-rows, 0), len(endpoint) - max(rows, 0))
    poses = replace(stated.poses.at_poses(kept), endpoint=endpoint[kept + rows])
    names = ("further down" if rows > 0 else "further up",)
    return Finding(FindingKind.ENDPOINTS_SHIFTED, names=names), _refitted(stated, poses)


def _with_table(arm: ArmModel, **columns: FloatArray) -> ArmModel:
    return replace(arm, table=replace(arm.table, **columns))


def turned_zero(stated: Experiment, estimate: Estimate) -> tuple[Finding, ...]:
    """Return the finding of a joint whose zero is a quarter or half turn off; empty if there is no such joint.

    The joint's offset in `estimate` is roughly this turn from nominal, and the poses fit once the turn is corrected. If
    they also fit with the sign of a neighbouring joint corrected, this is a second finding.
    """
    names, nominal = [p.name for p in estimate.parameters], nominal_vector(estimate.parameters)
    changes = dict(
        zip(names, wrap_angles(estimate.parameters, estimate.x - nominal).tolist(), strict=True)
    )
    for joint in range(1, stated.arm.joint_count + 1):
        change = changes.get(f"theta_off_{joint}", 0.0)
        turn = 0.5 * np.pi * round(change / (0.5 * np.pi))
        if not turn or abs(change - turn) >= LARGEST_OFFSET_RAD:
            continue
        if _closes(turned := _turned(stated, joint, turn)):
            # With a target anywhere on the tool, a neighbour's sign may explain the same readings.
            signs = {f"SIGN_JOINT_{joint - 1}", f"SIGN_JOINT_{joint + 1}"}
            by_sign = (x for x in _same_loop(stated) if not signs.isdisjoint(x[0].names))
            return _named([(x[0], 0.0) for x in (*filter(_closes, by_sign), turned)])
    return ()


def _closes(alternative: Alternative) -> bool:
    changed = alternative[1]
    return solved(_refitted(changed, changed.poses))[0] < limits.CHI2_PER_DOF_ALTERNATIVE


def _turned(stated: Experiment, joint: int, turn_rad: float) -> Alternative:
    offsets = stated.arm.table.theta_off_rad.copy()
    offsets[joint - 1] += turn_rad
    finding = Finding(FindingKind.ZERO_TURNED, joint=joint, size=turn_rad, unit="rad")
    return finding, replace(stated, arm=_with_table(stated.arm, theta_off_rad=offsets))


def _frozen(stated: Experiment) -> Iterator[Alternative]:
    """Yield alternatives in which a sensor is stuck in successive poses, of which only the first is used."""
    poses, sigma = stated.poses, stated.arm.sigma_rad()
    for j in range(1, poses.joint_count + 1):
        for first, last in constant_reading_runs(poses.q_rad, j, 3.0 * float(sigma[j - 1])):
            rest = np.setdiff1d(np.arange(len(poses)), np.arange(first + 1, last))
            if len(rest) >= 4 and j not in stated.unsensed:
                finding = Finding(
                    FindingKind.READING_FROZEN, joint=j, poses=poses.label[first:last]
                )
                yield finding, stated.at_poses(rest)


def _frozen_in_all_poses(stated: Experiment) -> Iterator[Alternative]:
    poses = stated.poses
    for j in range(1, poses.joint_count + 1):
        if constant_reading_runs(poses.q_rad, j, 0.0) == [(0, len(poses))]:
            finding = Finding(FindingKind.READING_FROZEN, joint=j, poses=poses.label)
            yield finding, without_reading(stated, j)


def _without_each_reading(stated: Experiment) -> Iterator[Alternative]:
    for j in range(1, stated.poses.joint_count + 1):
        if j not in stated.unsensed:
            sensor = sensor_name(j, stated.arm)
            finding = Finding(FindingKind.READING_UNRELATED, joint=j, sensor=sensor)
            yield finding, without_reading(stated, j)


def _shifted(blind: Experiment, unsensed: tuple[int, ...]) -> list[tuple[Finding, float, int]]:
    """Find a step in one joint's readings; list its finding, and chi2/dof and dof after correction of the step.

    `blind`: experiment that ignores the readings of the joints `unsensed` and of one more joint, which is tested. The
    list is empty if there is no step, or if `blind` does not ignore exactly one more joint.
    """
    more = [j for j in blind.unsensed if j not in unsensed]
    if len(more) != 1:
        return []
    (joint,) = more
    q = blind.poses.q_rad
    measured = tried(
        lambda: blind.loop().angle_of(without_readings(blind).unsensed, joint), otherwise=None
    )
    shift = None if measured is None else shift_of(q[:, joint - 1], measured)
    if shift is None:
        return []
    first, size_rad = shift
    back = q.copy()
    back[first:, joint - 1] -= size_rad
    alternative = replace(blind, poses=replace(blind.poses, q_rad=back), unsensed=unsensed)
    finding = reading_step(joint, size_rad, first, blind.arm, blind.poses.label)
    return [(finding, *solved(alternative))]


def _closest(
    alternatives: Iterable[Alternative], deadline: float, *, below: float
) -> list[Alternative]:
    costs: list[tuple[float, Alternative]] = []
    for finding, alternative in alternatives:
        if thread_time() > deadline:
            break
        costs.append((cost_of(alternative), (finding, alternative)))
    costs.sort(key=lambda cost: cost[0])
    return [
        alternative
        for cost, alternative in costs[:SOLVED_ALTERNATIVES]
        if np.isfinite(cost) and cost <= below
    ]
