"""Compares stated errors with the errors that the poses show: motion noise, exceeded specifications, scales.

Motion noise is the part of the fixture's deflection and of the joints' play that does not repeat at the same pose. It
is usually smaller than stated: files state upper limits, and most of the deflection and play repeats.
"""

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.diagnostics.limits import FALSE_ALARM_PROBABILITY, MOTION_NOISE_LEAST_SHARE
from solver.diagnostics.statistics import chi2_probability
from solver.estimators.layout import FIXTURE_NOISE
from solver.estimators.linear_fit import LinearFit
from solver.estimators.scoring import Derivatives, scale_spread, with_priors
from solver.estimators.variance_components import MOST_CERTAIN, NORMAL_95, standard_errors

MOTION_NOISE = (FIXTURE_NOISE, ("joint_play",))
"""Components of motion noise: first those of the fixture, then those of the joints."""

SCORING_STEPS = 6
"""Scoring steps after which variances of noise have converged to a few per cent."""


def with_estimated_motion_noise(fit: LinearFit) -> LinearFit:
    """Return `fit` with smaller motion noise of fixture and joints if the poses show less noise than stated.

    The stated variances of the fixture are multiplied by one factor, those of the joints by another. The factors
    follow from one scoring step of the restricted likelihood at the stated variances. The step would be exact if there
    were no other noise. Sensor noise is unchanged: less motion noise implies nothing about single readings.
    """
    design, stated = fit.design, fit.design.stated_variances()
    of_each = ([design.index[n] for n in names if n in design.index] for names in MOTION_NOISE)
    moving = [k for k in of_each if k]
    way = np.zeros((len(moving), len(stated)))
    for row, components in zip(way, moving, strict=True):
        row[components] = stated[components]
    slope = fit.stated.derivatives
    information = way @ slope.information @ way.T
    scales = 1.0 + np.linalg.lstsq(information, way @ slope.score, rcond=1e-9)[0]
    shares = np.clip(scales, MOTION_NOISE_LEAST_SHARE**2, 1.0)
    v = fit.at_known_noise.v.copy()
    for components, share in zip(moving, shares, strict=True):
        v[components] = np.minimum(v[components], share * stated[components])
    return LinearFit(design, fit.system, v)


def sensor_noise_with_estimated_motion(fit: LinearFit) -> tuple[FloatArray, FloatArray]:
    """Estimate the noise variances of `fit` again without priors; return all variances (K,) and their standard errors.

    The priors, which keep sigmas from being too small, would attribute part of a sensor's noise to fixture and joints.
    """
    design, v = fit.design, fit.v.copy()
    noise = design.noise_components
    least = design.floors.copy()
    moving = design.motion_components
    least[moving] = MOTION_NOISE_LEAST_SHARE**2 * design.stated_variances()[moving]
    for _ in range(SCORING_STEPS):
        slope = LinearFit(design, fit.system, v).derivatives
        information = slope.information[np.ix_(noise, noise)]
        size = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
        step = np.linalg.lstsq(
            information / np.outer(size, size), slope.score[noise] / size, rcond=1e-9
        )[0]
        v[noise] = np.maximum(v[noise] + step / size, least[noise])
    information = LinearFit(design, fit.system, v).derivatives.information
    return v, standard_errors(information, v, least)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExceededSpecification:
    """A source of error that exceeds its specification.

    `component`: name of the source in the error model. `times`: ratio of estimated to stated standard deviation.
    `log_chance`: logarithm of the probability that chance makes the estimate so large if the error is as stated.
    """

    component: str
    times: float
    log_chance: float


def exceeded_specifications(fit: LinearFit) -> tuple[ExceededSpecification, ...]:
    """Return the sources of error that certainly exceed their stated sizes.

    A variance v estimated with standard error s is taken as chi2-distributed with ``2 v^2 / s^2`` degrees of freedom
    (Satterthwaite). The smallest excess comes first, because it is the most plausible.
    """
    design, v = fit.design, fit.v
    stated = design.stated_variances()
    error = standard_errors(with_priors(fit).information, v, design.floors)
    exceeded = []
    for c, value, least, s in zip(design.components, v, stated, error, strict=True):
        if c.name in ("discrepancy", "placement") or not value > least > 0.0 or not np.isfinite(s):
            continue
        dof = 2.0 * min(value / max(float(s), 1e-300), MOST_CERTAIN) ** 2
        # Wilson and Hilferty's cube root where the chance is too small for a double.
        chance = float(chi2_probability(dof, dof * value / least))
        spread = 2.0 / (9.0 * dof)
        cube = ((value / least) ** (1.0 / 3.0) - 1.0 + spread) / np.sqrt(spread)
        log_chance = float(np.log(chance)) if chance > 1e-300 else float(-0.5 * cube**2)
        exceeded.append(
            ExceededSpecification(
                component=c.name, times=float(np.sqrt(value / least)), log_chance=log_chance
            )
        )
    level = np.log(FALSE_ALARM_PROBABILITY / max(len(design.components), 1))
    return tuple(sorted((x for x in exceeded if x.log_chance < level), key=lambda x: x.times))


FAMILIES = {
    "fixture_m": "fixture_play_position",
    "fixture_rad": "fixture_play_orientation",
    "joint_play": "play",
    "play_sides": "play_side",
    "encoder_accuracy": "encoders",
    "smooth_give": "compliance_smooth",
    "compliance": "compliance",
}
"""Names that results use for families of errors, by name of the variance component, where the two names differ."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """Ratio of actual to stated errors of one family, e.g. ``encoders``, and the 95 % interval of the ratio."""

    family: str
    value: float
    low: float
    high: float


def learned_scales(fit: LinearFit, derivatives: Derivatives) -> tuple[Scale, ...]:
    """Return the ratio of actual to stated errors (scale) of every family for which the fit estimates this ratio.

    `fit`: fit whose variances follow from the posterior means of the scales. `derivatives`: derivatives of the log
    posterior at `fit`. Log scales are taken as normally distributed (Laplace's approximation; method, section 10).
    """
    components = fit.design.components
    learned = [k for k, c in enumerate(components) if c.scaled]
    spread = scale_spread(fit, derivatives)[learned]
    out = []
    for k, s in zip(learned, np.sqrt(spread).tolist(), strict=True):
        c = components[k]
        mode = float(np.sqrt(fit.v[k] / c.start)) / float(np.exp(0.5 * s**2))
        wide = float(np.exp(NORMAL_95 * s))
        name = FAMILIES.get(c.name, c.name)
        out.append(Scale(family=name, value=mode, low=mode / wide, high=mode * wide))
    return tuple(out)


def shares_of_poses(fit: LinearFit) -> dict[str, float]:
    """Share of each parameter's information that comes from the poses, by name.

    The share is ``1 - posterior variance / prior variance``, or 1 for a parameter without a prior. The prior variance
    is the stated one, even if the fit estimates by which factor the actual errors differ from the stated ones.
    """
    design = fit.design
    names = [p.name for p in design.model.parameters]
    shares = dict.fromkeys(names, 1.0)
    variance = np.square(fit.standard_deviation)
    for k, sd in zip(design.prior_index.tolist(), design.prior_sd.tolist(), strict=True):
        shares[names[k]] = float(np.clip(1.0 - variance[k] / sd**2, 0.0, 1.0))
    return shares
