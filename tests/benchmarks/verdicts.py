"""Wrong calibrations that are accepted, and causes that are named, in simulated fault cases, as a table.

    python -m tests.benchmarks.verdicts [--arms 20] [--sound 100] [--workers 2] [--cases slips,elbow]

A result is wrong when any parameter that still has a truth is beyond four of its own sigmas. Bars: a
wrong result is never accepted without a cause or warning that names the fault; the right cause comes
first in 90 % of the arms; at most one in a hundred sound sets is refused. Column `unseen`: wrong, accepted, not named.
"""

import re
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tests.benchmarks.command_line import options, workers
from tests.benchmarks.shop_floor_files import read
from tests.benchmarks.shop_floor_outcome import CRASHED, REFUSED, Outcome, outcome
from tests.oracles.shop_floor import PARAMETERS
from tests.oracles.shop_floor_faults import CASES, sound
from tests.oracles.shop_floor_misread import Case

FIRST_SEED = 3000
RIGHT = 0.90
FALSE = 0.01


@dataclass(frozen=True, kw_only=True)
class Judged:
    """One case's outcome against what is true of it."""

    outcome: Outcome
    first: bool
    named: bool
    wrong: bool
    harmless: bool

    @property
    def accepted_wrong(self) -> bool:
        """Wrong, and accepted with nothing that says why."""
        return self.wrong and self.outcome.accepted and not self.named


def judged(case: Case) -> Judged:
    """Calibrate a case's session with the files its operator has, and compare."""
    arm, fixture = read(case.nominal)
    found = outcome(case.taken, arm=arm, fixture=fixture)
    patterns = [re.compile(c) for c in case.causes]

    def names(code: str) -> bool:
        return any(p.fullmatch(code) for p in patterns)

    return Judged(
        outcome=found,
        first=bool(found.causes) and names(found.causes[0]),
        named=any(names(c) for c in (*found.causes, *found.warnings)),
        wrong=found.has_result and bool(np.any(np.abs(_z(case, found)) > 4.0)),
        harmless=case.harmless,
    )


def _z(case: Case, found: Outcome) -> np.ndarray:
    """Errors in sigmas of the parameters that have a truth, to the nearer one of two."""
    z = found.z.copy()
    for name, other in case.either.items():
        k = PARAMETERS.index(name)
        elsewhere = found.error[k] + case.taken.truth[name] - other
        z[k] = min(z[k], elsewhere / found.sigma[k], key=abs)
    return z[[PARAMETERS.index(n) for n in case.judged]]


def one(job: tuple[str, int]) -> Judged:
    name, seed = job
    case = sound(seed) if name == "sound" else CASES[name](seed)
    found = judged(case)
    return replace(found, outcome=replace(found.outcome, said=found.outcome.said[:4000]))


def line(name: str, found: Sequence[Judged]) -> bool:
    """Print one row of the table; whether its bars are met."""
    n = len(found)
    accepted = sum(j.outcome.accepted for j in found)
    crashed = sum(j.outcome.verdict == CRASHED for j in found)
    first, named = (sum(getattr(j, key) for j in found) for key in ("first", "named"))
    wrong, accepted_wrong = (
        sum(getattr(j, key) for j in found) for key in ("wrong", "accepted_wrong")
    )
    if name == "sound":
        refused = sum(j.outcome.verdict in (REFUSED, CRASHED) for j in found)
        good = refused <= FALSE * n and accepted_wrong == 0
    else:
        good = accepted_wrong == 0 and crashed == 0
        good = good and (all(j.harmless for j in found) or first >= RIGHT * n)
    codes = Counter(j.outcome.causes[0] if j.outcome.causes else "-" for j in found)
    print(
        f"{name:28}{accepted:5}{n - accepted - crashed:5}{crashed:5}{wrong:6}{accepted_wrong:7}"
        f"{first:6}{named:6}   {'      ' if good else 'MISSED'} "
        f"{', '.join(f'{c} {k}' for c, k in codes.most_common(4))}",
        flush=True,
    )
    for j in found:
        if j.outcome.verdict == CRASHED:
            print("\n".join(f"      {text}" for text in j.outcome.said.splitlines()[-4:]))
            break
    return good


def main() -> int:
    """Run the cases and print them; 0 when every bar is met."""
    chosen = options(__doc__, arms=20, sound=100, workers=2, cases="")
    rows = {"sound": chosen.sound} | dict.fromkeys(CASES, chosen.arms)
    good = True
    print(
        f"{'case':28}{'acc.':>5}{'not':>5}{'crash':>5}{'wrong':>6}{'unseen':>7}{'first':>6}"
        f"{'named':>6}          first causes"
    )
    with workers(chosen.workers) as pool:
        for name, arms in rows.items():
            if arms and any(part in name for part in chosen.cases.split(",")):
                jobs = [(name, FIRST_SEED + k) for k in range(arms)]
                good = line(name, list(pool.map(one, jobs))) and good
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
