"""One BLAS thread while a function of the library computes; the caller's setting is restored when it returns."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import scipy.linalg  # noqa: F401 - its BLAS has to be loaded to be limited
from threadpoolctl import threadpool_limits

P = ParamSpec("P")
R = TypeVar("R")


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Run `function` with one BLAS thread.

    Matrices here have some tens of rows: more threads wait for each other and, on busy cores, take seconds
    instead of a third of one. The limit holds for the whole process until `function` returns.
    """

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
