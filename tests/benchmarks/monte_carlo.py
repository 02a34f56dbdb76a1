"""Monte-Carlo study of both estimators against the Cramer-Rao bound; prints a table. Run by hand:

    python tests/benchmarks/monte_carlo.py [--runs 2000] [--poses 60] [--wrist-mrad 6]

Truth, poses, readings and bound come from the oracles; only the estimates come from the project.
"""

# ruff: noqa: E402, T201 - threads are limited before NumPy starts; a benchmark prints

from __future__ import annotations

import os

# One thread a process: the matrices are small, and threads of two processes fight over two cores.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import argparse
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from solver.chain.kinematics import DhTable
from solver.chain.parameters import entries
from solver.estimators.implicit import NoiseModel, estimate_implicit
from solver.estimators.paper import estimate_paper
from solver.loops.dh import DhLoop
from tests.oracles.loop_oracle import closed_poses, cramer_rao
from tests.oracles.simulated_loops import PARAMETERS, Simulation

NORMAL_95 = 1.959963984540054


@dataclass(frozen=True)
class Study:
    """Errors and figures of many runs on the same poses."""

    bound: np.ndarray  # (P,) standard deviations of the Cramer-Rao bound
    implicit: np.ndarray  # (runs, P) errors
    paper: np.ndarray  # (runs, P) errors
    covered: np.ndarray  # (runs, P) whether the 95 % interval holds the truth
    chi2_per_dof: np.ndarray  # (runs,)
    iterations: np.ndarray  # (runs,)

    def ratio(self, errors: np.ndarray) -> np.ndarray:
        """RMSE over bound of every parameter."""
        return np.sqrt(np.mean(errors**2, axis=0)) / self.bound


def one_run(
    seed: int, *, simulation: Simulation, closed: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, int]:
    """Errors of implicit and paper, coverage, chi2/dof and iterations for one draw of noise."""
    truth = simulation.truth
    model = DhLoop(
        table=DhTable(
            theta_off_rad=truth.theta_off, s_m=truth.s, a_m=truth.a, alpha_rad=truth.alpha
        ),
        entries=entries(PARAMETERS),
        hinge=True,
    )
    q = simulation.read(closed, np.random.default_rng([seed, 7]))
    goal = truth.values(PARAMETERS)
    noise = NoiseModel(joint_variance=simulation.sigma() ** 2)
    implicit, paper = estimate_implicit(model, q, noise), estimate_paper(model, q)
    error = implicit.x - goal
    return (
        error,
        paper.x - goal,
        np.abs(error) < NORMAL_95 * implicit.standard_deviation,
        float(implicit.chi2 or np.nan) / implicit.dof,
        implicit.iterations,
    )


def study(runs: int, simulation: Simulation, *, workers: int = 1, seed: int = 0) -> Study:
    """Draw `runs` noises on one set of closed poses and estimate from each."""
    truth = simulation.truth
    closed = closed_poses(truth, np.random.default_rng(seed), simulation.poses)
    bound = cramer_rao(truth, closed, PARAMETERS, simulation.sigma() ** 2)
    run = partial(one_run, simulation=simulation, closed=closed)
    seeds = range(seed, seed + runs)
    if workers == 1:
        results = [run(s) for s in seeds]
    else:
        with ProcessPoolExecutor(workers) as pool:
            results = list(pool.map(run, seeds, chunksize=25))
    implicit, paper, covered, chi2, iterations = (np.array(v) for v in zip(*results, strict=True))
    return Study(
        bound=np.sqrt(np.diagonal(bound)),
        implicit=implicit,
        paper=paper,
        covered=covered,
        chi2_per_dof=chi2,
        iterations=iterations,
    )


def table(found: Study) -> str:
    """Return the study as text."""
    rows = ["parameter      CRB (urad, um)   RMSE/CRB   paper RMSE/CRB   95 % interval covers"]
    ratios, paper = found.ratio(found.implicit), found.ratio(found.paper)
    cover = found.covered.mean(axis=0)
    for k, name in enumerate(PARAMETERS):
        rows.append(
            f"{name:<14}{1e6 * found.bound[k]:14.3f}{ratios[k]:11.3f}{paper[k]:17.1f}"
            f"{100.0 * cover[k]:19.1f} %"
        )
    rows += [
        f"RMSE/CRB   {ratios.min():.3f} .. {ratios.max():.3f}   (goal 0.93 .. 1.07)",
        f"coverage   {100 * cover.min():.1f} .. {100 * cover.max():.1f} %   (goal 93 .. 97 %)",
        f"chi2/dof   {found.chi2_per_dof.mean():.4f}   (goal 0.97 .. 1.03)",
        f"paper/CRB  joints 1-5 {paper[:5].min():.0f} .. {paper[:5].max():.0f}",
        f"           joints 6-7 {paper[5:7].min():.1f} .. {paper[5:7].max():.1f}",
        f"iterations {found.iterations.mean():.1f} (implicit, from the paper's estimate)",
    ]
    return "\n".join(rows)


def within_goals(found: Study) -> bool:
    """Whether the goals of the method hold."""
    ratios, cover = found.ratio(found.implicit), found.covered.mean(axis=0)
    return bool(
        ratios.min() > 0.93
        and ratios.max() < 1.07
        and cover.min() > 0.93
        and cover.max() < 0.97
        and 0.97 < found.chi2_per_dof.mean() < 1.03
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study and print it; 0 when every goal is met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--poses", type=int, default=60)
    parser.add_argument("--wrist-mrad", type=float, default=6.0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args(arguments)
    simulation = Simulation(poses=options.poses, wrist_sd=1e-3 * options.wrist_mrad)
    start = time.perf_counter()
    found = study(options.runs, simulation, workers=options.workers)
    print(f"{options.runs} runs, {options.poses} poses, wrist noise {options.wrist_mrad:g} mrad")
    print(table(found))
    print(f"{time.perf_counter() - start:.0f} s on {options.workers} processes")
    return 0 if within_goals(found) else 1


if __name__ == "__main__":
    sys.exit(main())
