"""By how much less than stated fixture and joints move anew in every pose: the poses themselves tell.

Files state upper figures, and most of what gives or plays is the same again at the same pose. What one
reading shifted by is the plainer the better the rest is known. Knows a fit; no arm and no words.
"""

from __future__ import annotations

import numpy as np

from solver.arrays import FloatArray
from solver.estimators.component_report import standard_errors
from solver.estimators.linear_fit import LinearFit

LEAST = 0.2
"""Share of its statement (standard deviation) below which no fixture and no joint is believed to be quiet:
poses tell no better, and what repeats so well is hardly stated to give five times as much."""

ROUNDS = 6
"""Scoring steps after which variances of noise have settled to a few per cent of themselves."""


def as_quiet_as_found(fit: LinearFit) -> LinearFit:
    """Return `fit` as believed, with fixture and joints as quiet from pose to pose as they were found.

    Each of the two by the factor that the restricted likelihood's slope and information at the stated
    variances lead to: one scoring step, exact where the noise is all of a kind. A sensor's noise has
    its own component and stays: that most noise is quieter says nothing of single readings.
    """
    design, stated = fit.design, fit.design.stated_variances()
    play = [] if design.play_component is None else [design.play_component]
    moving = [k for k in (list(design.fixture_components.values()), play) if k]
    way = np.zeros((len(moving), len(stated)))
    for row, components in zip(way, moving, strict=True):
        row[components] = stated[components]
    slope = fit.stated.derivatives
    information = way @ slope.information @ way.T
    found = 1.0 + np.linalg.lstsq(information, way @ slope.score, rcond=1e-9)[0]
    v = fit.believed.v.copy()
    for components, share in zip(moving, np.clip(found, LEAST**2, 1.0), strict=True):
        v[components] = np.minimum(v[components], share * stated[components])
    return LinearFit(design, fit.system, v)


def noise_beside_quiet(fit: LinearFit) -> tuple[FloatArray, FloatArray]:
    """Variances (K,) of `fit` and their standard errors, those of noise where nothing is held at its statement.

    Floors keep sigmas honest and take from a sensor's noise what they give to fixture and joints.
    """
    design, v = fit.design, fit.v.copy()
    noise = design.noise_components
    least = design.floors.copy()
    moving = [*design.fixture_components.values()]
    moving += [] if design.play_component is None else [design.play_component]
    least[moving] = LEAST**2 * design.stated_variances()[moving]
    for _ in range(ROUNDS):
        slope = LinearFit(design, fit.system, v).derivatives
        information = slope.information[np.ix_(noise, noise)]
        size = np.sqrt(np.maximum(np.diagonal(information), 1e-300))
        step = np.linalg.lstsq(
            information / np.outer(size, size), slope.score[noise] / size, rcond=1e-9
        )[0]
        v[noise] = np.maximum(v[noise] + step / size, least[noise])
    information = LinearFit(design, fit.system, v).derivatives.information
    return v, standard_errors(information, v, least)
