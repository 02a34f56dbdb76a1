"""The real Panda of tests/data/panda_ball: the maker's D-H table, converted, and the readings."""

from pathlib import Path

import numpy as np

FOLDER = Path(__file__).resolve().parents[1] / "data" / "panda_ball"

# The maker's table, converted to the distal convention: row j has the link after joint j.
S_M = np.array([0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.107])
A_M = np.array([0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088, 0.0])
ALPHA_RAD = np.deg2rad([-90.0, 90.0, 90.0, -90.0, 90.0, 90.0, 0.0])


def panda_readings() -> tuple[np.ndarray, np.ndarray]:
    """Placement of each pose (m,) and joint angles (m, 7), rad."""
    rows = np.loadtxt(FOLDER / "panda_1.csv", delimiter=",", skiprows=1)
    return rows[:, 0].astype(int), np.deg2rad(rows[:, 2:9])


def scatter_mm(centres: np.ndarray, placement: np.ndarray) -> float:
    """Mean distance (mm) of the ball's centre (m, 3) from the mean of its placement, as in the README."""
    distances = [
        np.linalg.norm(centres[placement == k] - centres[placement == k].mean(axis=0), axis=1)
        for k in np.unique(placement)
    ]
    return float(np.concatenate(distances).mean() * 1e3)
