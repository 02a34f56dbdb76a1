"""Wrong calibrations that are accepted, and causes that are named, in simulated fault cases, as a table.

    python -m tests.benchmarks.verdicts [--arms 20] [--sound 100] [--workers 2] [--cases slips,elbow]

A result is wrong when any parameter with a defined true value is off by more than four of its own sigmas. Bars: a
wrong result is never accepted without a cause or warning that names the fault; the right cause comes
first in 90 % of the arms; at most one in a hundred sound sets is refused. Column `unseen`: wrong, accepted, not named.
"""

import re
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tests.benchmarks.command_line import options, workers
from tests.benchmarks.shop_floor_files import read
from tests.benchmarks.shop_floor_outcome import CRASHED, REFUSED, Outcome, outcome
from tests.oracles.shop_floor import PARAMETERS
from tests.oracles.shop_floor_faults import CASES, sound
from tests.oracles.shop_floor_misread import Case

FIRST_SEED = 3000
FIRST_SHARE = 0.90
FALSE_ALARM = 0.01


@dataclass(frozen=True, kw_only=True)
class Judged:
    """One case's outcome, compared with the true causes and values."""

    outcome: Outcome
    first: bool
    named: bool
    wrong: bool
    harmless: bool

    @property
    def accepted_wrong(self) -> bool:
        """Wrong, and accepted without the name of the fault."""
        return self.wrong and self.outcome.accepted and not self.named


def one(job: tuple[str, int]) -> Judged:
    """Calibrate the session of a case (name, seed) with the files of its operator, and compare."""
    name, seed = job
    case = sound(seed) if name == "sound" else CASES[name](seed)
    arm, fixture = read(case.nominal)
    result = outcome(case.taken, arm=arm, fixture=fixture)
    right = [
        any(re.fullmatch(pattern, code) for pattern in case.causes)
        for code in (*result.causes, *result.warnings)
    ]
    return Judged(
        outcome=result,
        first=bool(result.causes) and right[0],
        named=any(right),
        wrong=result.has_result and bool(np.any(np.abs(_z(case, result)) > 4.0)),
        harmless=case.harmless,
    )


def _z(case: Case, result: Outcome) -> np.ndarray:
    """Errors in sigmas of the parameters with a true value, from the nearer one of two."""
    z = result.z.copy()
    for name, other in case.either.items():
        k = PARAMETERS.index(name)
        z_of_other = (result.error[k] + case.taken.truth[name] - other) / result.sigma[k]
        z[k] = min(z[k], z_of_other, key=abs)
    return z[[PARAMETERS.index(n) for n in case.judged]]


def line(name: str, cases: Sequence[Judged]) -> bool:
    """Print one row of the table; whether its bars are met."""
    n, verdicts = len(cases), Counter(j.outcome.verdict for j in cases)
    accepted, crashed = sum(j.outcome.accepted for j in cases), verdicts[CRASHED]
    first, named, wrong, unseen = (
        sum(getattr(j, key) for j in cases) for key in ("first", "named", "wrong", "accepted_wrong")
    )
    if name == "sound":
        good = unseen == 0 and verdicts[REFUSED] + crashed <= FALSE_ALARM * n
    else:
        named_first = all(j.harmless for j in cases) or first >= FIRST_SHARE * n
        good = unseen == 0 and crashed == 0 and named_first
    codes = Counter(j.outcome.causes[0] if j.outcome.causes else "-" for j in cases)
    print(
        f"{name:28}{accepted:5}{n - accepted - crashed:5}{crashed:6}{wrong:6}{unseen:7}{first:6}{named:6}   "
        f"{'      ' if good else 'MISSED'} {', '.join(f'{c} {k}' for c, k in codes.most_common(4))}",
        *[f"\n{j.outcome.text}" for j in cases if j.outcome.verdict == CRASHED][:1],
        flush=True,
    )
    return good


def main() -> int:
    """Run the cases and print them; 0 when every bar is met."""
    chosen = options(__doc__, arms=20, sound=100, workers=2, cases="")
    rows = {"sound": chosen.sound} | dict.fromkeys(CASES, chosen.arms)
    good = True
    print(
        f"{'case':28}{'acc.':>5}{'not':>5}{'crash':>6}{'wrong':>6}{'unseen':>7}{'first':>6}{'named':>6}"
        "          first causes"
    )
    with workers(chosen.workers) as pool:
        for name, arms in rows.items():
            if arms and any(part in name for part in chosen.cases.split(",")):
                jobs = [(name, FIRST_SEED + k) for k in range(arms)]
                good = line(name, list(pool.map(one, jobs))) and good
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
