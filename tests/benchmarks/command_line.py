"""Options of the benchmarks, and processes for their work."""

import argparse
from concurrent.futures import ProcessPoolExecutor
from typing import Any

from threadpoolctl import threadpool_limits


def options(doc: str | None, **defaults: Any) -> argparse.Namespace:
    """Values of the options `defaults`, whose types are those of their default values; `doc` is the help."""
    parser = argparse.ArgumentParser(
        description=doc, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    for name, default in defaults.items():
        parser.add_argument(f"--{name}", type=type(default), default=default)
    return parser.parse_args()


def one_thread() -> None:
    """Limit linear algebra in this process to one thread."""
    import scipy.linalg  # noqa: F401 - its BLAS must be loaded before it can be limited

    threadpool_limits(1)


def workers(count: int) -> ProcessPoolExecutor:
    """Processes with one thread of linear algebra each."""
    return ProcessPoolExecutor(count, initializer=one_thread)
