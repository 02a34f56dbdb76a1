"""How well the parameters of a document are known together: correlations and budget. Knows no YAML and no document.

Beside the standard deviation of every entry this is the whole covariance, and where it comes from. Rounded:
a sigma is not known to more digits, and a file that goes to a controller is read by people.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from operator_app.config.quantities import Number
from operator_app.config.yaml_document import Path
from solver.arrays import FloatArray

CORRELATION_PLACES, SHARE_PLACES = 5, 4
SUM = 0.01
"""What rounding leaves of a sum of shares that should be 1."""

Correlation = Annotated[Number, Field(ge=-1.0, le=1.0)]
Share = Annotated[Number, Field(ge=0.0, le=1.0)]

Correlations = Mapping[str, tuple[Correlation, ...]]
"""Of each calibrated entry but the first: with every one listed before it, in their order."""
Budget = Mapping[str, Mapping[str, Share]]
"""Of a calibrated entry: the share of its variance that each source of error brings."""


def correlations_of(names: Sequence[str], covariance: FloatArray) -> dict[str, tuple[float, ...]]:
    """Return the correlations of parameters (k,) from their covariance (k, k); 0 for one without variance."""
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    scale = np.where(sd > 0.0, sd, np.inf)
    found = np.clip(covariance / np.outer(scale, scale), -1.0, 1.0)
    # Minus zero would be another text for the same.
    rounded = np.round(found, CORRELATION_PLACES) + 0.0
    return {name: tuple(rounded[k, :k].tolist()) for k, name in enumerate(names) if k}


def budget_of(
    names: Sequence[str], variance: FloatArray, parts: Mapping[str, FloatArray]
) -> dict[str, dict[str, float]]:
    """Return which share of each variance (k,) its parts bring; what rounds to nothing is left out."""
    found = {}
    for k, name in enumerate(names):
        if variance[k] > 0.0:
            shares = {s: round(float(v[k] / variance[k]), SHARE_PLACES) for s, v in parts.items()}
            found[name] = {source: share for source, share in shares.items() if share > 0.0}
    return found


def complaints_of_correlations(
    value: Mapping[str, Sequence[float]], names: Sequence[str]
) -> Iterator[tuple[Path, str, str]]:
    """Yield place, text and remedy of what does not fit the calibrated entries."""
    if value and list(value) != list(names[1:]):
        yield (), "are not of the calibrated entries after the first, in their order", _WHOLE
        return
    for k, (name, row) in enumerate(value.items(), 1):
        if len(row) != k:
            text = f"has {len(row)} correlations, {k} entries are calibrated before {name}"
            yield (name,), text, _WHOLE


def complaints_of_budget(
    value: Mapping[str, Mapping[str, float]], names: Sequence[str]
) -> Iterator[tuple[Path, str, str]]:
    """Yield place, text and remedy of what does not fit the calibrated entries, or adds up to nothing whole."""
    for name, shares in value.items():
        total = sum(shares.values())
        if name not in names:
            yield (name,), "is not listed as calibrated", "leave its budget out"
        elif abs(total - 1.0) > SUM:
            yield (name,), f"has shares that add up to {total:g}, not 1", _WHOLE


_WHOLE = "the document was changed in one place only"
