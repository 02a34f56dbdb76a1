"""One order for every pose set, whatever order it was taken in. Knows no estimator.

Floating-point sums depend on their order, and iterations that stop at rounding may stop elsewhere.
Estimators work on canonically ordered poses, so a shuffled pose set gives the same digits.
"""

from __future__ import annotations

import numpy as np

from solver.arrays import FloatArray, IntArray


def canonical_order(q: FloatArray) -> IntArray:
    """Indices that sort poses (m, n) by their first joint, then the second, ..."""
    return np.asarray(np.lexsort(q.T[::-1]), dtype=np.int64)


def back_to_caller(order: IntArray) -> IntArray:
    """Indices that undo `order`: ``values[order][back_to_caller(order)]`` is ``values``."""
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    return back
