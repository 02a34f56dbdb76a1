"""Can this calibration be right? Tests of what can go wrong, and what best explains a failed one.

All from one linear fit at the stated variances: no test refits. While nothing fires, no explanation is
asked for. When something does, all candidates are weighed on one scale and the best is taken in, until
what is left over is what the files state. Knows fits and arms; no file and no words.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.arm_model import ArmModel
from solver.estimators.linear_fit import LinearFit
from solver.judging.candidate import Candidate, Cause
from solver.judging.candidates import Scene
from solver.judging.evidence import (
    Evidence,
    evidence,
    noise_scale,
    probabilities,
    sound,
    unnamed,
)
from solver.judging.holdout import far_block, fold_poses
from solver.judging.left_over import LeftOver
from solver.judging.odd_poses import OddPoses, odd_poses, pose_columns
from solver.judging.quiet_noise import as_quiet_as_found
from solver.judging.steps import Step, steps

FALSE_ALARM = 1e-3
"""Chance of each test to fire on a sound pose set."""

DOUBT = 0.1
"""Chance of the pulls of a sound arm's lengths and twists to be worth a word, which refuses nothing: lengths
that are wrong by a few tolerances spoil a calibration before any test is sure of them."""

MOST_CAUSES = 4
"""Causes taken in one after the other; a set with more is no calibration."""

ENTRIES = ("lengths", "twists")
"""Sources that are entries of the maker's table."""

FOLDS, FAR_SHARE = 5, 0.2
"""Parts that are predicted by the rest, and the share of a block far from it."""

SEEN = 1e-6
"""Share of a column's square that has to be left for it to be tested."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Test:
    """One test: it fires when `statistic` exceeds `threshold`, on sound sets with `false_alarm`."""

    code: str
    statistic: float
    threshold: float
    false_alarm: float = FALSE_ALARM

    @property
    def fires(self) -> bool:
        """Whether the statistic is beyond the threshold."""
        return not self.statistic <= self.threshold


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
    step: Step | None
    left: LeftOver
    stated_chi2_per_dof: float
    apart: FloatArray
    scene: Scene

    @property
    def fires(self) -> bool:
        """Whether any test does."""
        return any(test.fires for test in self.tests)


def judge(fit: LinearFit, arm: ArmModel, *, taken: IntArray) -> Trial:
    """Test a fit.

    Parameters
    ----------
    fit
        The mixed model at its solution; it is judged at its *stated* variances, single readings by
        noise as found where that is less.
    taken
        (m,): when each pose of the fit was taken, its place among the others.
    """
    stated = fit.stated
    order = np.argsort(taken, kind="stable")
    scene = Scene.in_time(arm, stated.design, stated.whole, order)
    left = left_over_of(fit.believed, order)
    quiet = left_over_of(as_quiet_as_found(fit), order)
    tests = [chi2_test(stated.chi2, stated.dof)]
    odd, largest, more = _look(scene, left, quiet)
    tests += more
    tests += [*pull_tests(stated), *variance_tests(stated)]
    tests.append(prediction_test(stated))
    tests += scale_tests(scene, left)
    fires = any(test.fires for test in tests)
    doubtful = not fires and any(test.fires for test in pull_tests(stated, DOUBT))
    return Trial(
        tests=tuple(tests),
        rounds=tuple(_explain(scene, left, _curved(tests))) if fires else (),
        doubts=_doubted(scene, left) if doubtful else (),
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


def chi2_test(chi2: float, dof: int) -> Test:
    """Test chi2 at the stated variances."""
    from scipy.special import chdtri

    return Test(code="CHI2_STATED", statistic=chi2, threshold=float(chdtri(dof, FALSE_ALARM)))


def pull_tests(stated: LinearFit, false_alarm: float = FALSE_ALARM) -> list[Test]:
    """Test the largest pull of a toleranced entry, and their sum of squares."""
    from scipy.special import chdtri, ndtri

    # The first of all effects are these.
    z = stated.pulls[: sum(g.width for g in stated.design.groups if g.source in ENTRIES)]
    if not len(z):
        return []
    return [
        Test(
            code="PULL",
            statistic=float(np.abs(z).max()),
            threshold=float(-ndtri(0.5 * false_alarm / len(z))),
            false_alarm=false_alarm,
        ),
        Test(
            code="PULLS",
            statistic=float(z @ z),
            threshold=float(chdtri(len(z), false_alarm)),
            false_alarm=false_alarm,
        ),
    ]


def scale_tests(scene: Scene, left: LeftOver) -> list[Test]:
    """Test the scale of every encoder: the loops see a hundredth of it, and no other test asks."""
    from scipy.special import ndtri

    z = []
    for candidate in scene.scales():
        s, C = left.score(candidate.columns)
        # What the parameters take up but for a rounding error is not seen at all.
        whole = float((left.whiten(candidate.columns) ** 2).sum())
        z.append(abs(float(s[0])) / np.sqrt(C[0, 0]) if C[0, 0] > SEEN * whole else 0.0)
    if not z:
        return []
    threshold = float(-ndtri(0.5 * FALSE_ALARM / len(z)))
    return [Test(code="SCALE", statistic=float(max(z)), threshold=threshold)]


def prediction_test(stated: LinearFit) -> Test:
    """Predict every fifth of the poses, and a block far from the rest, by all the others."""
    from scipy.special import chdtri

    q = stated.design.q
    parts = (*fold_poses(q, FOLDS), far_block(q, FAR_SHARE)) if len(q) >= 2 * FOLDS else ()
    worst = Test(code="PREDICTION", statistic=0.0, threshold=np.inf)
    for poses in parts:
        chi2, dof = stated.held_out_chi2(poses)
        if dof:
            threshold = float(chdtri(dof, FALSE_ALARM / len(parts)))
            if chi2 / threshold > worst.statistic / worst.threshold:
                worst = Test(code="PREDICTION", statistic=chi2, threshold=threshold)
    return worst


def variance_tests(stated: LinearFit) -> list[Test]:
    """Test every variance: is the likelihood steeper at what is stated than chance makes it.

    The slope is a square of few directions (a sensor's gain and bow, say) less its expectation: in its
    standard deviations it is distributed as chi2 is, with as many degrees of freedom as its mean and
    variance say (Satterthwaite), and not as a normal variable.
    """
    from scipy.special import chdtri

    found = stated.derivatives
    names = [c.name for c in stated.design.components]
    information = np.maximum(np.diagonal(found.information), 1e-300)
    dof = np.maximum(0.5 * found.expected**2 / information, 1e-3)
    largest = (chdtri(dof, FALSE_ALARM / max(len(names), 1)) - dof) / np.sqrt(2.0 * dof)
    z = found.score / np.sqrt(information)
    return [
        Test(code=f"VARIANCE_{name.upper()}", statistic=float(s), threshold=float(t))
        for name, s, t in zip(names, z, largest, strict=True)
        if name != "discrepancy"
    ]


def _look(
    scene: Scene, left: LeftOver, quiet: LeftOver
) -> tuple[OddPoses, Step | None, list[Test]]:
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


def _curved(tests: Iterable[Test]) -> tuple[int, ...]:
    """Joints whose sensor's curve is larger than stated."""
    head = "VARIANCE_CURVE_"
    return tuple(
        int(t.code.removeprefix(head)) for t in tests if t.fires and t.code.startswith(head)
    )


def _explain(
    scene: Scene, left: LeftOver, curved: Collection[int]
) -> Iterable[tuple[Explanation, ...]]:
    """Take in the best explanation of what is left over, until nothing fires any more."""
    standing = tuple(scene.standing(curved))
    for _ in range(MOST_CAUSES):
        found = _weighed(left, (*_changes(scene, left), *standing))
        yield found
        best = found[0]
        if best.candidate is None or best.evidence is None:
            return
        if best.evidence.chi2 > GROSS * max(best.evidence.dof, 1):
            # Nothing linear explains this.
            return
        size = best.evidence.size * best.candidate.natural
        left = left.also_drawn(best.candidate.columns, size)
        _, _, tests = _look(scene, left, left)
        if left.dof <= 0 or not any(t.fires for t in (chi2_test(left.chi2, left.dof), *tests)):
            return


def _doubted(scene: Scene, left: LeftOver) -> tuple[Explanation, ...]:
    """Toleranced entries that may well be off their file, where no test is sure that anything is wrong."""
    found = _weighed(left, (*_changes(scene, left), *scene.standing(())))
    return tuple(
        x for x in found if x.candidate and x.candidate.cause in (Cause.LENGTH, Cause.TWIST)
    )


def _changes(scene: Scene, left: LeftOver) -> Iterable[Candidate]:
    """Steps and odd poses: candidates that are looked for in what is left."""
    scale = noise_scale(left.chi2, left.dof)
    suspects = {s.name: s for s in scene.suspects()}
    for step in steps(left, tuple(suspects.values()), scale=scale):
        yield scene.of_suspect(suspects[step.suspect], step.pose)
    odd = tuple(pose.pose for pose in odd_poses(left, scale=scale).odd)
    m = len(left.white)
    for count in range(1, len(odd) + 1):
        if count in (1, 2, 3, len(odd)):
            columns = pose_columns(left, odd[:count])
            yield Candidate(
                cause=Cause.ODD_POSES,
                subject="",
                columns=columns,
                natural=np.full(columns.shape[-1], 3.0),
                places=m**count,
                poses=odd[:count],
            )


def _weighed(left: LeftOver, candidates: Iterable[Candidate]) -> tuple[Explanation, ...]:
    """Probabilities of all candidates, of nothing wrong and of something without a name."""
    listed = [
        (c, e)
        for c in candidates
        if (e := evidence(left, c.columns, c.natural, most=c.most)) is not None
        and not c.is_stated(e.b, e.covariance)
        and float(np.sqrt(np.mean((e.b / c.natural) ** 2))) <= c.most
    ]
    counts: dict[Cause, int] = {}
    for c, _ in listed:
        counts[c.cause] = counts.get(c.cause, 0) + 1
    weights = [
        e.log_likelihood
        + np.log(PRIORS[c.cause] / counts[c.cause] / c.places)
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
