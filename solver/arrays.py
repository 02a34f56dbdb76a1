"""Array types of the solver, and read-only copies of arrays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def frozen(values: Sequence[float] | FloatArray) -> FloatArray:
    """Return a read-only float copy of `values`, for a field of a frozen dataclass."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array
