"""What a calibration costs, against what LAPACK needs at least; prints a table.

    python -m tests.benchmarks.speed [--poses 1000,10000,100000] [--solve 1000,10000,100000]

The floor is five `numpy.linalg.lstsq` of 500 x 14, single thread, in the same run: five iterations on
100 poses cannot cost less. Every time is the processor's. Runs and floors take turns, as a processor changes its
clock from one second to the next; what counts is the median of the runs in floors of their own moment, and the
least and the most of the turns stand beside it. Sizes run in processes of their own, so that each has a peak of
memory of its own.

`calibrate` is the whole default calibration, of an arm with RVDT curves, noise and counts alone (`calibrate0`), or
with every stated source of error drawn (`calibrate1` to 3): what people have. `checks` is what `sarcal solve` does
beyond it: the parts held out and the jackknife.

Bars: `calibrate` of 40 poses at most 150 floors, `implicit` of 100 at most 25, `paper` at most 8; growth at most
m^1.05, each of those sizes below 600 MB.
"""

import resource
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np
import sarcal

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.cross_validation import check
from solver.estimators.implicit import NoiseModel, estimate_implicit
from solver.estimators.paper import estimate_paper
from tests.benchmarks.command_line import one_thread, options
from tests.oracles.as_shipped import ARM, HINGE, poses_of
from tests.oracles.shop_floor import Sizes, session

BARS = {
    **{f"calibrate{arm} 40": 150.0 for arm in range(4)},
    "checks 40": np.inf,
    "implicit 100": 25.0,
    "paper 100": 8.0,
}
"""Kind and poses, and the most floors it may take."""
GROWTH, MEGABYTES = 1.05, 600.0
LONG_S, LONGEST_S = 1.0, 6.0


@dataclass(frozen=True)
class Cost:
    """Processor time (s) of each turn's run and floor, and the peak of memory."""

    seconds: np.ndarray
    floors: np.ndarray
    megabytes: float

    @property
    def ratios(self) -> np.ndarray:
        return self.seconds / self.floors


def work(kind: str, count: int) -> Callable[[], object]:
    if kind in ("checks", "calibrate1", "calibrate2", "calibrate3"):
        drawn = poses_of(session(int(kind[-1]) if kind != "checks" else 1, poses=count))
        if kind != "checks":
            return lambda: calibrate(ARM, HINGE, drawn)
        solution = calibrate(ARM, HINGE, drawn)
        return lambda: check(solution, ARM, HINGE, drawn)
    taken = session(1, Sizes.only(), poses=count)
    if kind == "calibrate0":
        poses = sarcal.poses_of(q_rad=taken.readings, sd_rad=taken.spread, samples=taken.samples)
        return lambda: calibrate(ARM, HINGE, poses._set)
    model, noise = HINGE.model(ARM), NoiseModel(joint_variance=ARM.sigma_rad() ** 2)
    if kind == "paper":
        return lambda: estimate_paper(model, taken.readings)
    x0 = estimate_paper(model, taken.readings).x
    return lambda: estimate_implicit(model, taken.readings, noise, x0=x0)


def least_s(function: Callable[[], object], *, of: int) -> float:
    """Least processor time (s) of a few calls: the first one finds the caches full of other things."""
    found = []
    for _ in range(of):
        before = time.process_time()
        function()
        found.append(time.process_time() - before)
        if found[-1] > LONG_S:
            break
    return min(found)


def cost(kind: str, count: int, turns: int) -> Cost:
    """Time one size beside the floor, in turns."""
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(500, 14)), rng.normal(size=500)
    function, seconds, floors, start = work(kind, count), [], [], time.process_time()
    while len(seconds) < turns and time.process_time() - start < LONGEST_S:
        floors.append(least_s(lambda: [np.linalg.lstsq(A, b, rcond=None) for _ in range(5)], of=10))
        seconds.append(least_s(function, of=3))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    return Cost(np.array(seconds), np.array(floors), peak)


def measured(kind: str, count: int, *, turns: int = 15) -> Cost:
    """Run `cost` in a process of its own, with one thread of linear algebra."""
    with ProcessPoolExecutor(1, get_context("spawn"), one_thread) as own:
        return own.submit(cost, kind, count, turns).result()


def main() -> int:
    """Measure and print; 0 when every bar is met."""
    sizes = "1000,10000,100000"
    chosen = options(__doc__, poses=sizes, solve=sizes)
    good = True
    for name, bar in BARS.items():
        kind, count = name.split()
        found = measured(kind, int(count))
        ratio = float(np.median(found.ratios))
        good = good and ratio <= bar
        print(
            f"{name:16}{1e3 * np.median(found.seconds):9.1f} ms  {ratio:8.1f} floors of "
            f"{1e3 * np.median(found.floors):.2f} ms ({'no bar' if np.isinf(bar) else f'bar {bar:.0f}'}), "
            f"{found.ratios.min():.1f} to {found.ratios.max():.1f} in {len(found.ratios)} turns  "
            f"{'' if ratio <= bar else 'MISSED'}",
            flush=True,
        )
    for kind, listed in (
        ("paper", chosen.poses), ("implicit", chosen.poses), ("calibrate0", chosen.solve),
    ):  # fmt: skip
        counts = [int(n) for n in listed.split(",") if n]
        costs = [measured(kind, n, turns=3) for n in counts]
        for n, found in zip(counts, costs, strict=True):
            met = found.megabytes < MEGABYTES
            good = good and met
            print(
                f"{kind:10}{n:8} poses {np.median(found.seconds):9.2f} s  {found.megabytes:7.0f} MB "
                f"{'' if met else 'MISSED'}"
            )
        if len(counts) > 1:
            times = [np.median(found.ratios) for found in costs]
            growth = float(np.log(times[-1] / times[0]) / np.log(counts[-1] / counts[0]))
            good = good and growth <= GROWTH
            print(
                f"{kind:10}grows with m^{growth:.2f} {'' if growth <= GROWTH else 'MISSED'}",
                flush=True,
            )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
