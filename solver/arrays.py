"""Array types of the solver, read-only copies of arrays, and records of arrays with one row per pose."""

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
"""Poses computed at a time: kinematics and Jacobian of this many fit in a core's cache."""


def frozen(values: Sequence[float] | FloatArray) -> FloatArray:
    """Return a read-only float copy of `values`, for a field of a frozen dataclass."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def select_poses(record: Record, poses: IntArray | BoolArray | slice, *fields: str) -> Record:
    """Return the record with a selection of poses from its `fields`, arrays (m, ...) or tuples; None stays None."""
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
    """Return the first record with the arrays `fields` (m, ...) of all `records`, one after the other."""
    parts = list(records)
    joined = {name: np.concatenate([getattr(p, name) for p in parts]) for name in fields}
    return replace(parts[0], **joined)


def pose_slices(m: int) -> list[slice]:
    """Cut m poses into slices of at most `BLOCK_POSES`."""
    return [slice(k, min(k + BLOCK_POSES, m)) for k in range(0, m, BLOCK_POSES)]
