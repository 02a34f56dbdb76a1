"""Can this calibration be right? Tests of what can go wrong, and what best explains a failed one.

All from one linear fit at the stated variances: no test refits. While nothing fires, no explanation is
asked for. When something does, all candidates are weighed on one scale and the best is taken in, until
what is left over is what the files state. Knows fits and arms; no file and no words.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import log

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.arm_model import ArmModel
from solver.diagnostics.change_points import ChangePoint, steps
from solver.diagnostics.fault_candidate import NONE_MEASURED, Candidate, Cause, Stray
from solver.diagnostics.fault_models import Scene
from solver.diagnostics.hypothesis_tests import (
    DOUBT,
    Test,
    but_curves_as_stated,
    chi2_test,
    prediction_test,
    pull_tests,
    scale_tests,
    variance_tests,
)
from solver.diagnostics.model_selection import (
    Evidence,
    evidence,
    evidence_of_own,
    noise_scale,
    probabilities,
    sound,
    unnamed,
)
from solver.diagnostics.outliers import OddPoses, odd_poses, pose_columns
from solver.diagnostics.stated_sizes import as_quiet_as_found
from solver.diagnostics.whitened_residuals import LeftOver, OwnColumns
from solver.estimators.linear_fit import LinearFit

MOST_CAUSES = 4
"""Causes taken in one after the other; a set with more is no calibration."""

GROSS = 30.0
"""chi2/dof that the best explanation leaves beyond which no second one is asked for."""

PARTLY = 2.0
"""chi2/dof that an explanation may leave and still be the whole story."""

LIKELY = 0.02
"""Least probability of a cause worth naming."""

PRIORS = {
    Cause.SLIPPED: 0.02,
    Cause.LOST_COUNTS: 0.02,
    Cause.ODD_POSES: 0.02,
    Cause.FROZEN: 0.01,
    Cause.READING: 0.01,
    Cause.CURVE: 0.02,
    Cause.LENGTH: 0.02,
    Cause.TWIST: 0.01,
    Cause.GIVES: 0.01,
    Cause.TURN_ERROR: 0.005,
    Cause.SAG: 0.003,
    Cause.SCATTER: 0.005,
    Cause.DRIFT: 0.001,
    Cause.SCALE: 0.003,
    Cause.LENGTH_CHANGED: 2e-5,
}
"""How often each happens, before anything is looked at; what is named here shares it among its subjects."""

UNNAMED = 0.002
"""How often something happens that is none of these."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Explanation:
    """A cause with what it is worth; `candidate` None stands for something that has no name here."""

    candidate: Candidate | None
    evidence: Evidence | None
    probability: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trial:
    """What the tests say.

    Attributes
    ----------
    tests
        All of them.
    rounds
        For each cause taken in, the explanations that competed, the most probable first.
    doubts
        Lengths and twists that may be off their file although no test fires, the most probable first.
    odd
        Poses that do not fit the others, indices in time order.
    step
        The most significant step of anything.
    left
        What the fit left over with noise as believed, poses in time order.
    stated_chi2_per_dof
        What it left over at stated variances.
    apart
        How far the estimate at stated variances lies from the one that was judged (P,), rad and m.
    scene
        The system the tests were made on.
    """

    tests: tuple[Test, ...]
    rounds: tuple[tuple[Explanation, ...], ...]
    doubts: tuple[Explanation, ...]
    odd: OddPoses
    step: ChangePoint | None
    left: LeftOver
    stated_chi2_per_dof: float
    apart: FloatArray
    scene: Scene

    @property
    def fires(self) -> bool:
        """Whether any test does."""
        return any(test.fires for test in self.tests)


def judge(
    fit: LinearFit,
    arm: ArmModel,
    *,
    taken: IntArray,
    measured: Mapping[int, Stray] = NONE_MEASURED,
) -> Trial:
    """Test a fit.

    Parameters
    ----------
    fit
        The mixed model at its solution; it is judged at its *stated* variances, single readings by
        noise as found where that is less.
    taken
        (m,): when each pose of the fit was taken, its place among the others.
    measured
        How far sensors stray from their best lines, by joint (1-based), where the loop measured it.
    """
    stated = fit.stated
    order = np.argsort(taken, kind="stable")
    scene = Scene.in_time(arm, stated.design, stated.whole, order)
    left = left_over_of(fit.believed, order)
    quiet = left_over_of(as_quiet_as_found(fit), order)
    tests = [chi2_test(stated.chi2, stated.dof)]
    odd, largest, more = _look(scene, left, quiet)
    tests += more
    tests += pull_tests(stated)
    tests += but_curves_as_stated(variance_tests(stated), scene, left, measured)
    tests.append(prediction_test(stated))
    tests += scale_tests(scene, left)
    fires = any(test.fires for test in tests)
    doubtful = not fires and any(test.fires for test in pull_tests(stated, DOUBT))
    return Trial(
        tests=tuple(tests),
        rounds=tuple(_explain(scene, left, odd, measured)) if fires else (),
        doubts=_doubted(scene, left, odd, measured) if doubtful else (),
        odd=odd,
        step=largest,
        left=left,
        stated_chi2_per_dof=stated.chi2 / max(stated.dof, 1),
        apart=_apart(fit, stated),
        scene=scene,
    )


def _apart(fit: LinearFit, stated: LinearFit) -> FloatArray:
    """Estimate at stated variances less the estimate (P,)."""
    design = fit.design
    out = np.zeros(len(design.nominal))
    out[design.hard_index] = stated.step - fit.step
    soft = len(design.soft_index)
    out[design.soft_index] = design.soft_sd * (stated.b[:soft] - fit.b[:soft])
    return out


def _look(
    scene: Scene, left: LeftOver, quiet: LeftOver
) -> tuple[OddPoses, ChangePoint | None, list[Test]]:
    """Look for odd poses and for steps with noise as believed; for those of a reading with `quiet` noise.

    At no smaller scale however little is left: where most of the noise is quieter than believed, that of
    single readings of one sensor need not be. What fixture and joints do that is neither new in every
    pose nor quite the smooth function that it is taken for passes for a change of the geometry, and
    hardly for one of a single reading.
    """
    odd = odd_poses(left)
    tests = [Test(code="POSE", statistic=odd.worst.chi2, threshold=odd.worst.threshold)]
    found = steps(left, scene.suspects(), quiet=quiet)
    if found:
        tests.append(Test(code="STEP", statistic=found[0].chi2, threshold=found[0].threshold))
    return odd, found[0] if found else None, tests


def _explain(
    scene: Scene, left: LeftOver, odd: OddPoses, measured: Mapping[int, Stray]
) -> Iterable[tuple[Explanation, ...]]:
    """Take in the best explanation of what is left over, until nothing fires any more."""
    standing = tuple(scene.standing(measured))
    for _ in range(MOST_CAUSES):
        found = _weighed(left, (*_changes(scene, left, odd), *standing))
        yield found
        best = found[0]
        if best.candidate is None or best.evidence is None:
            return
        if best.evidence.chi2 > GROSS * max(best.evidence.dof, 1):
            # Nothing linear explains this.
            return
        size = best.evidence.size * best.candidate.natural
        left = _taken_in(left, best.candidate, size)
        odd, _, tests = _look(scene, left, left)
        if left.dof <= 0 or not any(t.fires for t in (chi2_test(left.chi2, left.dof), *tests)):
            return


def _taken_in(left: LeftOver, cause: Candidate, sd: FloatArray) -> LeftOver:
    """Return what is left over when a cause is believed, its coefficients of known size `sd`."""
    if cause.own is None:
        return left.also_drawn(cause.columns, sd)
    return OwnColumns.of(left, cause.own, cause.columns * sd.reshape(len(cause.own), 1, -1)).drawn(
        left
    )


def _doubted(
    scene: Scene, left: LeftOver, odd: OddPoses, measured: Mapping[int, Stray]
) -> tuple[Explanation, ...]:
    """Toleranced entries that may well be off their file, where no test is sure that anything is wrong."""
    found = _weighed(left, (*_changes(scene, left, odd), *scene.standing(measured)))
    return tuple(
        x for x in found if x.candidate and x.candidate.cause in (Cause.LENGTH, Cause.TWIST)
    )


def _changes(scene: Scene, left: LeftOver, odd: OddPoses) -> Iterable[Candidate]:
    """Steps and odd poses: candidates that are looked for in what is left; `odd` are those with noise as believed."""
    scale = noise_scale(left.chi2, left.dof)
    suspects = {s.name: s for s in scene.suspects()}
    for step in steps(left, tuple(suspects.values()), scale=scale):
        yield scene.of_suspect(suspects[step.suspect], step.pose)
    found = odd if scale == 1.0 else odd_poses(left, scale=scale)
    poses = tuple(pose.pose for pose in found.odd)
    m = len(left.white)
    for count in range(1, len(poses) + 1):
        if count in (1, 2, 3, len(poses)):
            own = np.array(poses[:count])
            yield Candidate(
                cause=Cause.ODD_POSES,
                subject="",
                columns=pose_columns(left, own),
                own=own,
                natural=np.full(count * left.white.shape[1], 3.0),
                places=m**count,
                poses=poses[:count],
            )


def _evidence(left: LeftOver, c: Candidate) -> Evidence | None:
    if c.own is None:
        return evidence(left, c.columns, c.natural, most=c.most)
    return evidence_of_own(left, c.own, c.columns, c.natural, most=c.most)


def _weighed(left: LeftOver, candidates: Iterable[Candidate]) -> tuple[Explanation, ...]:
    """Probabilities of all candidates, of nothing wrong and of something without a name."""
    listed = [
        (c, e)
        for c in candidates
        if (e := _evidence(left, c)) is not None
        and not c.is_stated(e.b, e.covariance)
        and float(np.sqrt(np.mean((e.b / c.natural) ** 2))) <= c.most
    ]
    counts: dict[Cause, int] = {}
    for c, _ in listed:
        counts[c.cause] = counts.get(c.cause, 0) + 1
    weights = [
        e.log_likelihood
        + np.log(PRIORS[c.cause] / counts[c.cause])
        - log(c.places)
        # What leaves the rest larger than stated needs a second cause, and that one has no name.
        + (np.log(UNNAMED) if e.chi2 > PARTLY * max(e.dof, 1) else 0.0)
        for c, e in listed
    ]
    weights += [sound(left) + np.log(1.0 - sum(PRIORS.values())), unnamed(left) + np.log(UNNAMED)]
    chance = probabilities(np.array(weights))
    found = [
        Explanation(candidate=c, evidence=e, probability=float(p))
        for (c, e), p in zip(listed, chance[:-2], strict=True)
    ]
    found.append(Explanation(candidate=None, evidence=None, probability=float(chance[-1])))
    found.sort(key=lambda explanation: -explanation.probability)
    return tuple(x for k, x in enumerate(found) if k == 0 or x.probability >= LIKELY)


def left_over_of(fit: LinearFit, order: IntArray) -> LeftOver:
    """Return what a mixed model left over, its poses in the `order` (m,) given."""
    design, half = fit.design, fit.half
    size = np.ones(design.hard + len(design.soft_index))
    size[design.hard :] = design.soft_sd * fit.root[: len(design.soft_index)]
    place = np.argsort(np.concatenate((design.hard_index, design.soft_index)))
    there = np.argsort(order)
    m, r = len(design.q), design.model.equations_per_pose
    whitener, U, white = np.empty((m, r, r)), np.empty((m, r, design.width)), np.empty((m, r))
    for part in fit.parts():
        here = there[part.poses]
        whitener[here] = part.L_inverse
        U[here] = part.times(half)
        white[here] = part.w + part.times(fit.coefficients)
    return LeftOver(
        whitener=whitener,
        U=U,
        white=white,
        chi2=fit.chi2,
        to_x=(half[: len(size)] * size[:, None])[place],
        dof=fit.dof,
    )
