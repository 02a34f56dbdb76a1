"""Processor time and memory of calibrations, relative to LAPACK; prints a table.

    python -m tests.benchmarks.speed [--poses 1000,10000,100000]

The unit of time is five `numpy.linalg.lstsq` of 500 x 14 in the same process: five iterations on 100 poses need as much
at least. Runs and units take turns, since a processor changes its clock from one second to the next; the figure is
the median of their ratios. `calibrate0` is the default calibration of an arm with RVDT curves, noise and counts alone,
`calibrate1` of one with every stated source of error.

Bars: `calibrate` of 40 poses at most 120 units, `implicit` of 100 at most 25, `paper` at most 8; `--poses` grow with
at most m^1.05, and stay below 600 MB.
"""

import resource
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np

from operator_app.calibration.calibrate import calibrate
from solver.estimators.implicit import NoiseModel, estimate_implicit
from solver.estimators.paper import estimate_paper
from tests.benchmarks.command_line import one_thread, options
from tests.oracles.as_shipped import ARM, HINGE, poses_of
from tests.oracles.shop_floor import Sizes, session

BARS = {"calibrate0 40": 120, "calibrate1 40": 120, "implicit 100": 25, "paper 100": 8}
"""Kind and number of poses, and the longest time in units."""
GROWTH, MEGABYTES = 1.05, 600.0
TURNS, LONGEST_S = 15, 6.0


def work(kind: str, count: int) -> Callable[[], object]:
    taken = session(1, Sizes() if kind == "calibrate1" else Sizes.only(), poses=count)
    if kind.startswith("calibrate"):
        poses = poses_of(taken)
        return lambda: calibrate(ARM, HINGE, poses)
    model, noise = HINGE.model(ARM), NoiseModel(joint_variance=ARM.sigma_rad() ** 2)
    if kind == "paper":
        return lambda: estimate_paper(model, taken.readings)
    x0 = estimate_paper(model, taken.readings).x
    return lambda: estimate_implicit(model, taken.readings, noise, x0=x0)


def processor_s(function: Callable[[], object]) -> float:
    before = time.process_time()
    function()
    return time.process_time() - before


def cost(kind: str, count: int) -> tuple[float, float, float]:
    """Processor time (s, units) and the peak of memory (MB)."""
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(500, 14)), rng.normal(size=500)
    function, seconds, units, start = work(kind, count), [], [], time.process_time()
    while len(seconds) < TURNS and time.process_time() - start < LONGEST_S:
        units.append(
            min(
                processor_s(lambda: [np.linalg.lstsq(A, b, rcond=None) for _ in range(5)])
                for _ in range(10)
            )
        )
        seconds.append(min(processor_s(function) for _ in range(3 if count <= 100 else 1)))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return float(np.median(seconds)), float(np.median(np.divide(seconds, units))), peak


def measured(name: str) -> tuple[float, float, float]:
    """Run `cost` in a process of its own, with one thread of linear algebra, and print it."""
    kind, count = name.split()
    with ProcessPoolExecutor(1, get_context("spawn"), one_thread) as own:
        seconds, units, megabytes = own.submit(cost, kind, int(count)).result()
    print(f"{name:20}{seconds:9.3f} s{units:10.1f} units{megabytes:7.0f} MB", flush=True)
    return seconds, units, megabytes


def main() -> int:
    """Measure and print; 0 when every bar is met."""
    counts = options(__doc__, poses="1000,10000,100000").poses.split(",")
    met = [measured(name)[1] <= bar for name, bar in BARS.items()]
    good = all(met)
    for kind in ("paper", "implicit", "calibrate0"):
        _, units, megabytes = zip(*[measured(f"{kind} {n}") for n in counts], strict=True)
        growth = np.log(units[-1] / units[0]) / np.log(int(counts[-1]) / int(counts[0]))
        print(f"{kind} grows with m^{growth:.2f}")
        good = good and growth <= GROWTH and max(megabytes) < MEGABYTES
    print("" if good else "MISSED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
