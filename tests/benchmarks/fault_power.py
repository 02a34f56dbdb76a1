"""How small a fault can any test find: a length that is off, a joint's reading that shifts? A table.

    python -m tests.benchmarks.fault_power [--arms 5]

The best test of one fault looks for that fault only and knows where it is (Neyman and Pearson): its statistic is
normal with a mean of the fault's size over its standard deviation. A verdict that must look at every length, joint
and pose can do no better; the last column is the power of one that may raise as few false alarms over all of them
together (Bonferroni). Of a length against everything the files state; of a shift of a reading with the noise
that the poses show. tests/solver/estimators/test_mixed_model.py compares the statistic with dense matrices. Bar for
the verdict (tests/benchmarks/verdicts.py): 90 % of slips of 50 counts named.
"""

import sys

import numpy as np
from scipy.special import ndtr, ndtri

from solver.diagnostics.stated_sizes import with_estimated_motion_noise
from tests.benchmarks.command_line import options
from tests.oracles.as_shipped import fit_of
from tests.oracles.shop_floor import RVDTS, session
from tests.oracles.shop_floor_misread import COUNT, LSB

FIRST_SEED = 3000
LEVEL = 1e-3
LENGTHS = ("s_3", "s_5")
PLACES = range(8, 33)
"""Where the verdict's cases slip."""


def sigmas(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations of the best estimates of each length, m (2,), and of a shift at each place, rad (7, k)."""
    fit = fit_of(session(seed))
    names = [p.name for p in fit.estimate.parameters]
    rates = fit.linear.whole
    lengths = rates.A[:, :, [names.index(n) for n in LENGTHS]]
    after = fit.order[:, None] >= PLACES
    shifts = np.einsum("mrj,mk->mrjk", rates.B, after).reshape(*rates.w.shape, -1)
    known = with_estimated_motion_noise(fit.linear)
    of_lengths, of_shifts = (
        1.0 / np.sqrt(np.diagonal(linear.score(columns)[1]))
        for linear, columns in ((fit.linear.stated, lengths), (known, shifts))
    )
    return of_lengths, of_shifts.reshape(7, -1)


def line(name: str, size: str, z: np.ndarray, everywhere: int) -> None:
    """Print the power at sizes of `z` (k,) standard deviations, of one test and of so many at once."""
    power = [float(ndtr(z + ndtri(0.5 * LEVEL / n)).mean()) for n in (1, everywhere)]
    print(f"{name:12}{size:>12}{z.mean():10.2f} ({z.min():6.2f}){power[0]:10.3f}{power[1]:10.3f}")


def main() -> int:
    arms = options(__doc__, arms=5).arms
    lengths, shifts = map(
        np.array, zip(*map(sigmas, range(FIRST_SEED, FIRST_SEED + arms)), strict=True)
    )
    print(f"{'fault':12}{'size':>12}{'in sigmas':>10} (least){'known':>11}{'anywhere':>10}")
    for name, column in zip(LENGTHS, lengths.T, strict=True):
        for mm in (1.0, 2.0, 5.0, 30.0):
            line(name, f"{mm:g} mm", 1e-3 * mm / column, len(LENGTHS))
    for counts in (5, 50):
        for j in range(7):
            shift = counts * (LSB if j + 1 in RVDTS else COUNT)
            line(f"joint {j + 1}", f"{counts} counts", shift / shifts[:, j].ravel(), shifts[0].size)
    return 0


if __name__ == "__main__":
    sys.exit(main())
