"""Do the 95 % intervals cover? Arms from the shop floor, one error source at a time; prints a table.

    python -m tests.benchmarks.honesty [--arms 300] [--workers 2] [--rows all,nothing]

Bars: all sources together 92-98 %, each parameter at least 85 %; at half the stated size 92-99 %, at twice 85 % or not
accepted. A source alone: at least 91 % under the shipped files, which admit all the others as well, and
91-99 % under files that state this source only (`... stated`); no source: at least 93 % either way."""

import sys
from collections import Counter
from dataclasses import dataclass
from functools import partial

import numpy as np

from tests.benchmarks.command_line import options, workers
from tests.benchmarks.shop_floor_files import read
from tests.benchmarks.shop_floor_outcome import ACCEPTED, NORMAL_95, WARNED, Outcome, outcome
from tests.oracles.shop_floor import PARAMETERS, SOURCES, Sizes, session

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
    """Outcomes of many arms under one set of sizes."""

    name: str
    outcomes: list[Outcome]

    @property
    def z(self) -> np.ndarray:
        return np.array([o.z for o in self.outcomes if o.has_result]).reshape(-1, len(PARAMETERS))

    @property
    def cover(self) -> np.ndarray:
        return np.mean(np.abs(self.z) < NORMAL_95, axis=0)

    def share(self, verdict: str) -> float:
        return float(np.mean([o.verdict == verdict for o in self.outcomes]))

    def good(self) -> bool:
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


def printed(row: Row) -> None:
    z = row.z
    results = len(z)
    if not results:
        print(f"{row.name:17} no result in {len(row.outcomes)}", flush=True)
        return
    error = np.array([o.error for o in row.outcomes if o.has_result])
    offsets = np.rad2deg(np.sqrt(np.mean(error[:, :5] ** 2)))
    print(
        f"{row.name:17}{100 * np.mean(row.cover):6.1f} %{100 * row.cover.min():6.0f} %"
        f"{np.sqrt(np.mean(z**2)):8.2f}{offsets:13.4f}"
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
    said = Counter(code for o in row.outcomes for code in {*o.warnings, *o.causes})
    if said:
        print(f"{'':12}said: {', '.join(f'{c} {n}' for c, n in said.most_common(8))}", flush=True)


def main() -> int:
    """Run the study and print it; 0 when every bar is met."""
    chosen = options(__doc__, arms=300, workers=2, rows=",".join(DRAWN))
    seeds = range(FIRST_SEED, FIRST_SEED + chosen.arms)
    print(f"{chosen.arms} arms, 40 poses, 32 samples; default options")
    print(
        f"{'source':17}{'cover':>8}{'worst':>8}{'rms z':>8}{'rms 1-5 deg':>13}"
        f"{'accepted':>9}{'warn':>8}{'not':>7}{'time':>7}"
    )
    good = True
    with workers(chosen.workers) as pool:
        for name in filter(None, chosen.rows.split(",")):
            sizes = DRAWN[name]
            stated = sizes if name.endswith(" stated") else None
            outcomes = list(pool.map(partial(one_arm, sizes=sizes, stated=stated), seeds))
            row = Row(name=name, outcomes=outcomes)
            printed(row)
            good = row.good() and good
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
