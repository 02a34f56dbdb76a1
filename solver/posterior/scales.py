"""Estimated size of each source of error over its stated size, and the poses' share of a parameter's information."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.estimators.likelihood import Derivatives
from solver.estimators.linear_fit import LinearFit
from solver.estimators.scoring import scale_spread

NORMAL_95 = 1.959963984540054

FAMILIES = {
    "fixture_m": "fixture_play_position",
    "fixture_rad": "fixture_play_orientation",
    "joint_play": "play",
    "play_sides": "play_side",
    "encoder_accuracy": "encoders",
    "smooth_give": "compliance_smooth",
    "compliance": "compliance",
}
"""Names of the families in results, where they differ from the component's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """Size of one family of errors over what the files state, with its 95 % interval."""

    family: str
    value: float
    low: float
    high: float


def learned_scales(fit: LinearFit, found: Derivatives) -> tuple[Scale, ...]:
    """Return the scale of every family of errors whose size is estimated.

    The variances of `fit` are at the posterior mean of the sizes, `found` are the derivatives with these: the
    logarithm of a size is normal about its mode (Laplace's approximation; method, section 10).
    """
    components = fit.design.components
    learned = [k for k, c in enumerate(components) if c.scaled]
    if not learned:
        return ()
    spread = scale_spread(fit, found)[learned]
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

    It is 1 minus posterior over prior variance; 1 for a parameter without a prior. The prior is the stated one,
    whatever scale its family was found to have.
    """
    design = fit.design
    names = [p.name for p in design.model.parameters]
    found = dict.fromkeys(names, 1.0)
    variance = np.square(fit.standard_deviation)
    for k, sd in zip(design.soft_index.tolist(), design.soft_sd.tolist(), strict=True):
        found[names[k]] = float(np.clip(1.0 - variance[k] / sd**2, 0.0, 1.0))
    return found
