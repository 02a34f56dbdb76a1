"""Array types, read-only copies of arrays, records with one row per pose, and evenly spread indices and points."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Record = TypeVar("Record", bound="DataclassInstance")

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

BLOCK_POSES = 1024
"""Number of poses computed at a time: their kinematics and Jacobian fit in a core's cache."""


def frozen(values: Sequence[float] | FloatArray) -> FloatArray:
    """Return a read-only float copy of `values`, for a field of a frozen dataclass."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def select_poses(record: Record, poses: IntArray | BoolArray | slice, *fields: str) -> Record:
    """Return a copy of `record` with only the rows `poses` of its `fields`: arrays (m, ...), tuples or None."""
    selected = {}
    for name in fields:
        values = getattr(record, name)
        if isinstance(values, tuple):
            values = tuple(values[k] for k in np.arange(len(values))[poses].tolist())
        elif values is not None:
            values = values[poses]
        selected[name] = values
    return replace(record, **selected)


def join_poses(records: Iterable[Record], *fields: str) -> Record:
    """Return a copy of the first record with the arrays `fields`, each (m, ...), concatenated over all `records`."""
    parts = list(records)
    joined = {name: np.concatenate([getattr(p, name) for p in parts]) for name in fields}
    return replace(parts[0], **joined)


def pose_slices(m: int) -> list[slice]:
    """Cut m poses into slices of at most `BLOCK_POSES`."""
    return [slice(k, min(k + BLOCK_POSES, m)) for k in range(0, m, BLOCK_POSES)]


def evenly(count: int, most: int) -> IntArray:
    """Return the indices of at most `most` of `count` items, evenly chosen."""
    return np.linspace(0, count - 1, min(most, count)).astype(np.int64)


def even_points(count: int, n: int, start: float | FloatArray = 0.5) -> FloatArray:
    """Points (count, n) of the unit cube, spread far more evenly than random points.

    They follow an additive recurrence (Roberts' R_n: steps are powers of 1/g, with ``g^(n+1) = g + 1``) from `start`,
    a number or (n,), and are the same on every machine.
    """
    g = 2.0
    for _ in range(60):
        g = (1.0 + g) ** (1.0 / (n + 1))
    return np.asarray(
        (start + np.arange(1, count + 1)[:, None] * g ** -np.arange(1.0, n + 1)) % 1.0
    )
