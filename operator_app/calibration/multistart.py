"""Fits from several starts, and checks whether another solution is better or nearer to the nominal values."""

from collections.abc import Collection, Iterable
from itertools import islice

import numpy as np

from operator_app.messages.finding import Finding, FindingKind
from solver.arrays import FloatArray, IntArray, evenly
from solver.chain.parameters import Parameter, nominal_vector, wrap_angles
from solver.diagnostics import limits
from solver.errors import PosesDoNotFitError
from solver.estimators.error_model import ErrorModel
from solver.estimators.estimate import Estimate
from solver.estimators.least_squares import Fit, Problem, Progress, solve_damped
from solver.estimators.paper import closure_problem
from solver.estimators.variance_components import Calibrated, estimate_with_errors
from solver.loops.closure import ClosureModel
from solver.loops.endpoints import BASE, GROUND, TIP, TIP_TURN

SCREENING_POSES = 600
"""The best of several starts is found with at most this many poses, chosen evenly from all poses."""


def fit_from_starts(
    model: ClosureModel,
    q: FloatArray,
    errors: ErrorModel,
    starts: Iterable[FloatArray | None],
    *,
    group: IntArray,
    progress: Progress | None = None,
) -> Calibrated:
    """Fit from each start until a fit explains the readings within the stated errors; return the best fit.

    `group` (m,): placement of each pose. Raises `PosesDoNotFitError` if no start leads to a fit.
    """
    starts, several = iter(starts), len(q) > 2 * SCREENING_POSES
    first = islice(starts, 1) if several else starts
    data = (model, q, errors, group)
    best, least = _best_fit(first, *data, progress)
    if several and not least < limits.CHI2_PER_DOF_SECOND_START:
        screened = evenly(len(q), SCREENING_POSES)
        part = (model.at_poses(screened), q[screened], errors.at_poses(screened), group[screened])
        few, misfit = _best_fit(starts, *part)
        if few is not None and misfit < limits.OTHER_START_MISFIT_SHARE * least:
            other, other_misfit = _best_fit((few.estimate.x,), *data, progress)
            best = other if other_misfit < least else best
    if best is None:
        raise PosesDoNotFitError
    return best


def _best_fit(
    starts: Iterable[FloatArray | None],
    model: ClosureModel,
    q: FloatArray,
    errors: ErrorModel,
    group: IntArray,
    progress: Progress | None = None,
) -> tuple[Calibrated | None, float]:
    """Fit from each start until a fit is good; return the best fit and its chi2/dof, or None and inf if all fail."""
    best: Calibrated | None = None
    least = np.inf
    for x0 in starts:
        try:
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
                calibrated = estimate_with_errors(
                    model, q, errors, x0=x0, group=group, progress=progress
                )
                misfit = gross_misfit(calibrated)
        except (PosesDoNotFitError, np.linalg.LinAlgError):
            continue
        if misfit < least:
            best, least = calibrated, misfit
        if least < limits.CHI2_PER_DOF_SECOND_START:
            break
    return best, least


def gross_misfit(calibrated: Calibrated) -> float:
    """Return chi2/dof at stated variances; infinite if chi2 is not finite."""
    ratio = calibrated.linear.stated.chi2 / max(calibrated.linear.dof, 1)
    return float(ratio) if np.isfinite(ratio) else np.inf


LOCAL_STARTS, SPREAD_RAD, SPREAD_M = 8, np.deg2rad(25.0), 0.05
ITERATIONS = 25


def far_from_nominal(
    parameters: tuple[Parameter, ...], x: FloatArray, sd: FloatArray | None = None
) -> list[tuple[Parameter, float]]:
    """Return the parameters whose values `x` (P,) are implausibly far from nominal, each with its change (rad, m).

    The largest change, relative to its limit, comes first. If `sd` (P,) is given, three standard deviations are added
    to the limits, because a weakly determined parameter may have any value.
    """
    spread = np.zeros(len(x)) if sd is None else 3.0 * np.nan_to_num(sd, nan=np.inf)
    changes = wrap_angles(parameters, x - nominal_vector(parameters)).tolist()
    far = [
        (p, change)
        for p, change, more in zip(parameters, changes, spread, strict=True)
        if abs(change) > _limit(p) + more
    ]
    return sorted(far, key=lambda item: -abs(item[1]) / _limit(item[0]))


def local_minimum_causes(
    model: ClosureModel, identified: Estimate, q: FloatArray | None = None
) -> tuple[Finding, ...]:
    """Return a finding if an estimate is implausibly far from nominal; it states whether another solution fits better.

    `identified`: estimate of the identified parameters. `q`: readings (m, n) of the used poses, rad; None: no other
    solution is sought. The fixture's placement may be far from nominal if no other solution is better.
    """
    far = _far(_without_placements(identified))
    near_nominal, times = False, dict[str, float]()
    if far and q is not None:
        known = identified.values_by_name
        identified_model = model.without([p.name for p in model.parameters if p.name not in known])
        problem = closure_problem(identified_model, q)
        x = nominal_vector(identified_model.parameters, known)
        own = solve_damped(problem, x, max_iterations=ITERATIONS).cost
        fits = _fits(identified_model, problem)
        best = min(fit.cost for fit in fits)
        if best < limits.OTHER_SOLUTION_COST_SHARE * own:
            times = {"times": float(np.sqrt(own / max(best, 1e-300)))}
        near_nominal = any(
            limits.OTHER_SOLUTION_COST_SHARE * fit.cost < own
            and all(
                p.name.endswith("]")
                for p, _ in far_from_nominal(identified_model.parameters, fit.x)
            )
            for fit in fits
        )
    if not times and not near_nominal:
        # The poses determine where the fixture is, so that this is only a note (`fixture_elsewhere`).
        far = [item for item in far if item[0].name not in of_fixture(model)]
    if not far:
        return ()
    p, change = far[0]
    finding = Finding(
        FindingKind.OTHER_SOLUTION if times else FindingKind.FAR_FROM_NOMINAL,
        names=(p.name,),
        size=change,
        unit=p.unit,
        figures=times,
        probability=1.0 if times else 0.5,
        blocking=True,
    )
    return (finding,)


def of_fixture(model: ClosureModel) -> set[str]:
    """Return the names of the parameters of the fixture's placement; of several placements, only those of the first.

    The placements of an instrument's base and target are not included: if these are far off, a file is wrong.
    """
    sides = {
        name
        for name in (*model.ground_side, *model.hand_side)
        if name.partition("[")[0] not in {*BASE, *TIP, *TIP_TURN}
    }
    return {name for name in sides if not name.endswith("]") or name.endswith("[1]")}


def fixture_elsewhere(estimate: Estimate, model: ClosureModel) -> tuple[Finding, ...]:
    """Return a notice, without effect on the verdict, if the fixture is far from where its file states."""
    far = _far(estimate.without({p.name for p in estimate.parameters} - of_fixture(model)))
    if not far:
        return ()
    p, change = far[0]
    socket = p.name.partition("[")[0] in GROUND
    kind = FindingKind.SOCKET_ELSEWHERE if socket else FindingKind.FIXTURE_ELSEWHERE
    return (Finding(kind, names=(p.name,), size=change, unit=p.unit),)


def best_about_nominal(model: ClosureModel, q: FloatArray) -> FloatArray:
    """Return the parameters (P,) of `model` that close the loops best, found from starts around the nominal values."""
    return min(_fits(model, closure_problem(model, q)), key=lambda fit: fit.cost).x


def _fits(model: ClosureModel, problem: Problem) -> list[Fit]:
    nominal = nominal_vector(model.parameters)
    angles = np.array([p.is_angle for p in model.parameters])
    rng = np.random.default_rng(0)
    spread = np.where(angles, SPREAD_RAD, SPREAD_M)
    starts = [nominal, *(nominal + spread * rng.uniform(-1.0, 1.0, (LOCAL_STARTS, len(nominal))))]
    return [solve_damped(problem, x, max_iterations=ITERATIONS) for x in starts]


OF_THE_SOLUTION = {
    FindingKind.SIGMAS_USELESS,
    FindingKind.SIGMAS_WIDE,
    FindingKind.FAR_FROM_NOMINAL,
    FindingKind.PARALLEL_AXES,
    FindingKind.NOT_CONVERGED,
}
"""Kinds of causes that describe the solution itself, and cannot have made it diverge."""


def has_diverged(
    causes: Iterable[Finding],
    scale: float,
    identified: Estimate,
    *,
    anywhere: Collection[str] = (),
) -> bool:
    """Whether blocking `causes` made the solution diverge: a value is far from nominal, or too uncertain for any use.

    `scale`: chi2/dof at stated variances, which has to be too large, except if another solution is the cause.
    `identified`: estimate of the identified parameters. `anywhere`: names of parameters that may be far from nominal.
    """
    # A local optimum counts as diverged even if it fits well.
    if not any(
        c.blocking
        and (c.kind is FindingKind.OTHER_SOLUTION or scale > limits.CHI2_PER_DOF_REFUSED)
        and c.kind not in OF_THE_SOLUTION
        for c in causes
    ):
        return False
    described = _without_placements(identified)
    worthless = np.where(
        [p.is_angle for p in described.parameters], limits.USELESS_SIGMA_RAD, limits.USELESS_SIGMA_M
    )
    return bool((~(described.standard_deviation <= worthless)).any()) or any(
        p.name not in anywhere for p, _ in _far(described)
    )


def _far(estimate: Estimate) -> list[tuple[Parameter, float]]:
    return far_from_nominal(estimate.parameters, estimate.x, estimate.standard_deviation)


def _limit(parameter: Parameter) -> float:
    return limits.FAR_FROM_NOMINAL_RAD if parameter.is_angle else limits.FAR_FROM_NOMINAL_M


def _without_placements(estimate: Estimate) -> Estimate:
    """Return the estimate without parameters that belong to one of several placements."""
    return estimate.without([p.name for p in estimate.parameters if p.name.endswith("]")])
