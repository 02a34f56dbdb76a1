"""Coverage of the 95 % intervals on simulated arms, together and with one error source at a time; prints a table.

    python -m tests.benchmarks.honesty [--arms 300] [--workers 2] [--rows all,nothing]

Bars: all sources together 92-98 %, each parameter at least 85 %; at half the stated size 92-99 %, at twice 85 % or not
accepted. A source alone: at least 91 % under the packaged files, which state all the others as well, and
91-99 % under files that state this source only (`... stated`); no source: at least 93 % either way."""

import sys
from collections.abc import Sequence
from functools import partial

import numpy as np

from tests.benchmarks.command_line import options, workers
from tests.benchmarks.shop_floor_files import read
from tests.benchmarks.shop_floor_outcome import ACCEPTED, NORMAL_95, WARNED, Outcome, outcome
from tests.oracles.shop_floor import PARAMETERS, SOURCES, Sizes, session

ROWS: dict[str, tuple[Sizes, float, float]] = {
    "nothing": (Sizes.only(), 0.93, 1.0),
    **{source: (Sizes.only(source), 0.91, 1.0) for source in SOURCES},
    "all": (Sizes(), 0.92, 0.98),
    "all half": (Sizes.only(*SOURCES, times=0.5), 0.92, 0.99),
    "all twice": (Sizes.only(*SOURCES, times=2.0), 0.85, 1.0),
    "nothing stated": (Sizes.only(), 0.93, 1.0),
    **{f"{source} stated": (Sizes.only(source), 0.91, 0.99) for source in SOURCES},
}
"""Sizes of the true errors, and the least and the largest coverage, by row."""

FIRST_SEED = 1000


def one_arm(seed: int, *, sizes: Sizes, stated: Sizes | None) -> Outcome:
    """Calibrate one arm with default options; files that state `stated`, or the packaged ones."""
    arm, fixture = read({}, stated)
    return outcome(session(seed, sizes), arm=arm, fixture=fixture)


def line(name: str, outcomes: Sequence[Outcome]) -> bool:
    """Print one row of the table, and the parameters below 85 %; whether its bars are met."""
    z = np.array([o.z for o in outcomes if o.has_result])
    if not len(z):
        print(f"{name:17} no result in {len(outcomes)}", flush=True)
        return False
    inside = np.abs(z) < NORMAL_95
    cover = inside.mean(axis=0)
    if name == "all twice":
        accepted = [o.accepted for o in outcomes if o.has_result]
        inside = inside[accepted] if any(accepted) else np.ones(1)
    _, low, high = ROWS[name]
    good = low <= inside.mean() <= high and (name != "all" or cover.min() >= 0.85)
    shares = [np.mean([o.verdict == v for o in outcomes]) for v in (ACCEPTED, WARNED)]
    print(
        f"{name:17}{cover.mean():8.1%}{cover.min():8.0%}{np.sqrt(np.mean(z**2)):8.2f}{shares[0]:9.0%}"
        f"{shares[1]:8.0%}{1.0 - sum(shares):7.0%}   {'' if good else 'MISSED'}",
        *[f"\n    {n} {c:.0%}" for n, c in zip(PARAMETERS, cover, strict=True) if c < 0.85],
        flush=True,
    )
    return bool(good)


def main() -> int:
    """Run the study and print it; 0 when every bar is met."""
    chosen = options(__doc__, arms=300, workers=2, rows=",".join(ROWS))
    seeds = range(FIRST_SEED, FIRST_SEED + chosen.arms)
    good = True
    print(f"{'source':17}{'cover':>8}{'worst':>8}{'rms z':>8}{'accepted':>9}{'warn':>8}{'not':>7}")
    with workers(chosen.workers) as pool:
        for name in filter(None, chosen.rows.split(",")):
            sizes, *_ = ROWS[name]
            stated = sizes if name.endswith(" stated") else None
            outcomes = list(pool.map(partial(one_arm, sizes=sizes, stated=stated), seeds))
            good = line(name, outcomes) and good
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
