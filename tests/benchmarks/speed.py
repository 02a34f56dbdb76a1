"""What a calibration costs, against what LAPACK needs at least; prints a table.

    python tests/benchmarks/speed.py [--poses 1000,10000,100000] [--solve 1000,10000,100000]

The floor is five `numpy.linalg.lstsq` of 500 x 14, single thread, in the same run: five iterations on
100 poses cannot cost less. Every time is the processor's. Runs and floors take turns, as a processor changes its
clock from one second to the next; what counts is the median of the runs in floors of their own moment, and the
least and the most of the turns stand beside it. Sizes run in processes of their own, so that each has a peak of
memory of its own.

`calibrate` is the whole default calibration, `sound` of an arm with RVDT curves, noise and counts alone, `all N` of
three arms with every stated source of error drawn (lengths, twists, encoders, give, sag, play): what people have.
`checks` is what `sarcal solve` does beyond it: the parts held out and the jackknife.

Bars: `calibrate` of 40 poses at most 150 floors, `implicit` of 100 at most 25, `paper` at most 8; growth at most
m^1.05, each of those sizes below 600 MB.
"""

# ruff: noqa: E402, T201 - threads are limited before NumPy starts; a benchmark prints

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.cross_validation import check
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import parse_poses
from solver.chain.poses import PoseSet
from solver.estimators.implicit import NoiseModel, estimate_implicit
from solver.estimators.paper import estimate_paper
from tests.oracles.shop_floor import Sizes, Specimen, closed_walk, session, taken

BARS = {
    "sound 40": 150.0,
    "all1 40": 150.0,
    "all2 40": 150.0,
    "all3 40": 150.0,
    "checks 40": np.inf,
    "implicit 100": 25.0,
    "paper 100": 8.0,
}
"""Kind and poses, and the most floors it may take."""
GROWTH, MEGABYTES = 1.05, 600.0
CHUNK = 2000
LONG_S, LONGEST_S = 1.0, 6.0


def pose_set(count: int) -> PoseSet:
    """Poses of one arm without errors but RVDT curves, noise and counts."""
    specimen = Specimen.drawn(1, Sizes.only())
    parts = []
    for walk in range(-(-count // CHUNK)):
        rest = min(CHUNK, count - CHUNK * walk)
        parts.append(taken(specimen, *closed_walk(specimen, rest, walk=walk), walk=walk))
    q = np.concatenate([p.readings for p in parts])
    return PoseSet(
        placement=np.ones(count, dtype=np.int64),
        label=tuple(f"p{k}" for k in range(count)),
        q_rad=q,
        sd_rad=np.concatenate([p.spread for p in parts]),
        samples=np.full(count, 32),
    )


def all_sources(seed: int, count: int) -> PoseSet:
    """Poses of one arm with every source of error at its stated size."""
    text = session(seed, Sizes.everything(), poses=count).csv()
    return parse_poses(text.encode(), "poses.csv").poses


def work(kind: str, count: int) -> Callable[[], object]:
    """Return what is to be timed."""
    arm, fixture = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
    if kind == "checks" or kind.startswith("all"):
        drawn = all_sources(int(kind.removeprefix("all") if kind != "checks" else 1), count)
        if kind != "checks":
            return lambda: calibrate(arm, fixture, drawn)
        solution = calibrate(arm, fixture, drawn)
        return lambda: check(solution, arm, fixture, drawn)
    poses = pose_set(count)
    if kind in ("calibrate", "sound"):
        return lambda: calibrate(arm, fixture, poses)
    model, q = fixture.model(arm), np.array(poses.q_rad)
    if kind == "paper":
        return lambda: estimate_paper(model, q)
    noise = NoiseModel(joint_variance=arm.sigma_rad() ** 2)
    x0 = estimate_paper(model, q).x
    return lambda: estimate_implicit(model, q, noise, x0=x0)


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


def floor() -> Callable[[], object]:
    """Return five `lstsq` of 500 x 14."""
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(500, 14)), rng.normal(size=500)
    return lambda: [np.linalg.lstsq(A, b, rcond=None) for _ in range(5)]


def child(kind: str, count: int, turns: int) -> None:
    """Time one size and print it with this process's peak of memory."""
    function, least = work(kind, count), floor()
    seconds, floors, start = [], [], time.process_time()
    for _ in range(turns):
        floors.append(least_s(least, of=10))
        seconds.append(least_s(function, of=3))
        if time.process_time() - start > LONGEST_S:
            break
    ratios = np.array(seconds) / np.array(floors)
    print(
        json.dumps(
            {
                "s": float(np.median(seconds)),
                "mb": _peak_mb(),
                "floor_s": float(np.median(floors)),
                "floors": float(np.median(ratios)),
                "least": float(ratios.min()),
                "most": float(ratios.max()),
                "turns": len(ratios),
            }
        )
    )


def measured(kind: str, count: int, *, turns: int = 15) -> dict[str, float]:
    """Run `child` in a process of its own."""
    done = subprocess.run(
        [sys.executable, __file__, "--child", kind, str(count), str(turns)],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        print(done.stderr[-2000:], file=sys.stderr)
        raise SystemExit(f"{kind} of {count} poses did not end well: exit code {done.returncode}")
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def _peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; 0 when every bar is met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", default="1000,10000,100000", help="sizes of paper and implicit")
    parser.add_argument(
        "--solve", default="1000,10000,100000", help="sizes of the whole calibration"
    )
    parser.add_argument("--child", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.child:
        child(options.child[0], int(options.child[1]), int(options.child[2]))
        return 0
    good = True
    for name, bar in BARS.items():
        kind, count = name.split()
        found = measured(kind, int(count))
        ratio = found["floors"]
        good = good and ratio <= bar
        said = "no bar" if np.isinf(bar) else f"bar {bar:.0f}"
        print(
            f"{name:16}{1e3 * found['s']:9.1f} ms  {ratio:8.1f} floors of "
            f"{1e3 * found['floor_s']:.2f} ms ({said}), {found['least']:.1f} to {found['most']:.1f} in "
            f"{found['turns']:.0f} turns  {'' if ratio <= bar else 'MISSED'}",
            flush=True,
        )
    for kind, sizes in (
        ("paper", options.poses), ("implicit", options.poses), ("calibrate", options.solve),
    ):  # fmt: skip
        counts = [int(n) for n in sizes.split(",") if n]
        found = [measured(kind, n, turns=3) for n in counts]
        for n, f in zip(counts, found, strict=True):
            met = f["mb"] < MEGABYTES
            good = good and met
            print(
                f"{kind:10}{n:8} poses {f['s']:9.2f} s  {f['mb']:7.0f} MB {'' if met else 'MISSED'}"
            )
        if len(counts) > 1:
            times = [f["floors"] for f in found]
            growth = np.log(times[-1] / times[0]) / np.log(counts[-1] / counts[0])
            good = good and bool(growth <= GROWTH)
            print(
                f"{kind:10}grows with m^{growth:.2f} {'' if growth <= GROWTH else 'MISSED'}",
                flush=True,
            )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
