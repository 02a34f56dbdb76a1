"""Do the 95 % intervals cover? Arms from the shop floor, one error source at a time; prints a table.

    python -m tests.benchmarks.honesty [--arms 300] [--workers 2] [--rows all,nothing] [--csv FILE]

Bars: all sources together 92-98 %, each parameter at least 85 %; at half the stated size 92-99 %, at twice 85 % or not
accepted. A source alone: at least 91 % under the shipped files, which admit all the others as well, and
91-99 % under files that state this source only (`... stated`); no source: at least 93 % either way. The
error over the bound is that of the best linear estimate that knows how the arms were drawn
(`tests.oracles.shop_floor_bound`).
"""

# ruff: noqa: T201 - a benchmark prints

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
from threadpoolctl import threadpool_limits

from tests.benchmarks.shop_floor_files import read
from tests.benchmarks.shop_floor_outcome import ACCEPTED, NORMAL_95, WARNED, Outcome, outcome
from tests.oracles.shop_floor import PARAMETERS, SOURCES, Sizes, session
from tests.oracles.shop_floor_bound import bound

ALONE: dict[str, Sizes] = {
    "nothing": Sizes.only(),
    **{source: Sizes.only(source) for source in SOURCES},
}
DRAWN: dict[str, Sizes] = {
    **ALONE,
    "all": Sizes.everything(),
    "all half": Sizes.everything(times=0.5),
    "all twice": Sizes.everything(times=2.0),
    **{f"{name} stated": sizes for name, sizes in ALONE.items()},
}
"""What is drawn, by row."""

WANTED = {
    "nothing": (0.93, 1.0),
    "nothing stated": (0.93, 1.0),
    "all": (0.92, 0.98),
    "all half": (0.92, 0.99),
    "all twice": (0.85, 1.0),
    **dict.fromkeys(SOURCES, (0.91, 1.0)),
    **{f"{source} stated": (0.91, 0.99) for source in SOURCES},
}
FIRST_SEED = 1000


@dataclass(frozen=True, kw_only=True)
class Row:
    """Outcomes of many arms under one set of sizes, and the bounds (k, 14) of the first of them."""

    name: str
    outcomes: list[Outcome]
    bounds: np.ndarray

    @property
    def z(self) -> np.ndarray:
        """Errors in sigmas (n, 14) where there is a result."""
        return np.array([o.z for o in self.outcomes if o.has_result]).reshape(-1, len(PARAMETERS))

    @property
    def cover(self) -> np.ndarray:
        """Share of arms whose 95 % interval holds the truth, (14,)."""
        return np.mean(np.abs(self.z) < NORMAL_95, axis=0)

    def share(self, verdict: str) -> float:
        """Share of arms with a verdict."""
        return float(np.mean([o.verdict == verdict for o in self.outcomes]))

    def over_bound(self) -> np.ndarray:
        """Root mean square of errors over their bounds, (14,)."""
        pairs = [
            o.error / b for o, b in zip(self.outcomes, self.bounds, strict=False) if o.has_result
        ]
        return np.sqrt(np.mean(np.square(pairs), axis=0)) if pairs else np.full(14, np.nan)

    def good(self) -> bool:
        """Whether the bars are met."""
        low, high = WANTED[self.name]
        cover = float(np.mean(self.cover))
        if self.name == "all twice":
            held = [np.abs(o.z) < NORMAL_95 for o in self.outcomes if o.accepted and o.has_result]
            cover = float(np.mean(held)) if held else 1.0
        return low <= cover <= high and (self.name != "all" or bool(self.cover.min() >= 0.85))


def one_arm(seed: int, *, sizes: Sizes, stated: Sizes | None) -> Outcome:
    """Calibrate one arm with default options; files that state `stated`, or the shipped ones."""
    arm, fixture = read({}, stated)
    return outcome(session(seed, sizes), arm=arm, fixture=fixture)


def one_bound(seed: int, *, sizes: Sizes) -> np.ndarray:
    """Best standard deviations (14,) for one arm's poses."""
    return bound(session(seed, sizes), sizes)


def many_poses(seed: int, *, poses: int) -> Outcome:
    """Calibrate an arm with every error from so many poses."""
    return outcome(session(seed, Sizes.everything(), poses=poses))


def pasted(seed: int) -> np.ndarray:
    """Factors (14,) by which sigmas change when the same readings are in the file four times."""
    taken = session(seed, Sizes.everything())
    once, four = (outcome(taken.picked(np.tile(np.arange(40), n))) for n in (1, 4))
    return four.sigma / once.sigma


def of_repetition(pool: ProcessPoolExecutor, seeds: Sequence[int]) -> bool:
    """Print what more readings of the same thing do to sigmas; whether they stay honest."""
    factor = np.array(list(pool.map(pasted, seeds)))
    change = float(np.nanmax(np.abs(factor - 1.0)))
    print(f"pasted four times: sigmas change by {100 * change:.0f} % at most (bar 10 %)")
    good = change <= 0.10
    found = {n: list(pool.map(partial(many_poses, poses=n), seeds)) for n in (20, 240)}
    for n, outcomes in found.items():
        row = Row(name="all", outcomes=outcomes, bounds=np.zeros((0, 14)))
        if not len(row.z):
            print(f"{n} poses: no result")
            return False
        cover = float(np.mean(row.cover))
        sigma = np.median([o.sigma[:5] for o in outcomes if o.has_result])
        print(
            f"{n} poses: cover {100 * cover:.1f} %, worst {100 * row.cover.min():.0f} %, "
            f"median sigma of offsets 1-5 {np.rad2deg(sigma):.4f} deg",
            flush=True,
        )
        good = good and cover >= 0.92
    return good


def printed(row: Row) -> None:
    """Print a line, and who undercovers."""
    z = row.z
    results = len(z)
    if not results:
        print(f"{row.name:17} no result in {len(row.outcomes)}", flush=True)
        return
    error = np.array([o.error for o in row.outcomes if o.has_result])
    offsets = np.rad2deg(np.sqrt(np.mean(error[:, :5] ** 2)))
    ratio = row.over_bound()
    sharp = f"{np.sqrt(np.nanmean(ratio**2)):6.2f}" if len(row.bounds) else f"{'-':>6}"
    print(
        f"{row.name:17}{100 * np.mean(row.cover):6.1f} %{100 * row.cover.min():6.0f} %"
        f"{np.sqrt(np.mean(z**2)):8.2f}{offsets:10.4f} {sharp}"
        f"{100 * row.share(ACCEPTED):7.0f} %{100 * row.share(WARNED):6.0f} %"
        f"{100 * (1.0 - row.share(ACCEPTED) - row.share(WARNED)):6.0f} %"
        f"{np.mean([o.seconds for o in row.outcomes]):7.2f} s   {'' if row.good() else 'MISSED'}"
    )
    weak = [
        f"{n} {100 * c:.0f} % (rms z {s:.1f})"
        for n, c, s in zip(PARAMETERS, row.cover, np.sqrt(np.mean(z**2, axis=0)), strict=True)
        if c < 0.85
    ]
    if weak:
        print(f"{'':12}below 85 %: {', '.join(weak)}")
    if len(row.bounds):
        print(f"{'':12}over bound: {' '.join(f'{v:.2f}' for v in ratio)}")
    said = Counter(code for o in row.outcomes for code in {*o.warnings, *o.causes})
    if said:
        print(f"{'':12}said: {', '.join(f'{c} {n}' for c, n in said.most_common(8))}", flush=True)


def _bounds(sizes: Sizes, options: argparse.Namespace) -> int:
    """How many bounds to find: loads take long, the rest is cheap."""
    return options.bounds if sizes.give_m or sizes.sag_rad else options.arms


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study and print it; 0 when every bar is met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=300)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--bounds", type=int, default=40, help="arms of which the bound is found")
    parser.add_argument("--rows", default=",".join(DRAWN))
    parser.add_argument("--repeated", type=int, default=10, help="arms with readings repeated")
    options = parser.parse_args(arguments)
    seeds = range(FIRST_SEED, FIRST_SEED + options.arms)
    print(f"{options.arms} arms, 40 poses, 32 samples; default options")
    print(
        f"{'source':17}{'cover':>8}{'worst':>8}{'rms z':>8}{'rms 1-5 deg':>11}{'/bound':>7}"
        f"{'accepted':>8}{'warn':>7}{'not':>7}{'time':>7}"
    )
    good = True
    with ProcessPoolExecutor(options.workers, initializer=threadpool_limits, initargs=(1,)) as pool:
        for name in filter(None, options.rows.split(",")):
            sizes = DRAWN[name]
            stated = sizes if name.endswith(" stated") else None
            row = Row(
                name=name,
                outcomes=list(pool.map(partial(one_arm, sizes=sizes, stated=stated), seeds)),
                bounds=np.array(
                    list(
                        pool.map(partial(one_bound, sizes=sizes), seeds[: _bounds(sizes, options)])
                    )
                ),
            )
            printed(row)
            good = row.good() and good
        if options.repeated:
            good = of_repetition(pool, seeds[: options.repeated]) and good
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
