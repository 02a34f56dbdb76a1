"""Second implementation of the closed loop: closed poses and the Cramer-Rao bound. Shares no code with `solver`.

Products of homogeneous matrices, with derivatives by complex step: slow, and exact to the last digit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

COLUMNS = ("theta_off", "s", "a", "alpha")


@dataclass(frozen=True)
class Chain:
    """D-H columns of links 0..n, rad and m; true angle = reading + `theta_off`."""

    theta_off: np.ndarray
    s: np.ndarray
    a: np.ndarray
    alpha: np.ndarray

    def value(self, name: str) -> float:
        column, row = name.rsplit("_", 1)
        return float(getattr(self, column)[int(row)])

    def values(self, names) -> np.ndarray:
        return np.array([self.value(name) for name in names])

    def with_values(self, names, values) -> Self:
        columns = {c: np.array(getattr(self, c)) for c in COLUMNS}
        for name, value in zip(names, values, strict=True):
            column, row = name.rsplit("_", 1)
            columns[column][int(row)] = value
        return replace(self, **columns)

    def changed(self, **changes: float) -> Self:
        return self.with_values(changes.keys(), changes.values())


@dataclass(frozen=True)
class Truth(Chain):
    """A chain with a measured home pose (n,)."""

    home: np.ndarray


def paper_truth() -> Truth:
    """Tables 1 and 2 of the paper with the home pose of the data sets."""
    return Truth(
        theta_off=np.deg2rad([0.0, 9.9, -122.8, -21.1, -9.2, 27.1, 116.3, 89.3]),
        s=np.array([0.014, 0.273, 0.0, 0.355, 0.0, 0.320, 0.0, 0.038]),
        a=np.array([0.202, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -0.101]),
        alpha=np.deg2rad([-38.5, 90.0, -90.0, 90.0, -90.0, 90.0, -90.0, 99.8]),
        home=np.deg2rad([40.5311, 245.5792, 143.1309, -115.0631, -189.2465, -215.6707, 44.9482]),
    )


def product(theta, s, a, alpha, beta=0.0):
    """A_0 A_1 ... A_n (..., 4, 4) of actual joint angles (..., L), real or complex."""
    theta, s, a, alpha, beta = np.broadcast_arrays(theta, s, a, alpha, beta)
    T = np.broadcast_to(np.eye(4), (*theta.shape[:-1], 4, 4))
    for j in range(theta.shape[-1]):
        c, sn = np.cos(theta[..., j]), np.sin(theta[..., j])
        ca, sa = np.cos(alpha[..., j]), np.sin(alpha[..., j])
        zero, one = np.zeros_like(c), np.ones_like(c)
        rows = [
            [c, -sn * ca, sn * sa, a[..., j] * c],
            [sn, c * ca, -c * sa, a[..., j] * sn],
            [zero, sa, ca, s[..., j]],
            [zero, zero, zero, one],
        ]
        T = T @ np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
        cb, sb = np.cos(beta[..., j]), np.sin(beta[..., j])
        Ry = [[cb, zero, sb, zero], [zero, one, zero, zero], [-sb, zero, cb, zero], rows[3]]
        T = T @ np.stack([np.stack(row, axis=-1) for row in Ry], axis=-2)
    return T


def closure(truth: Chain, angles):
    """Antisymmetric part of the rotation, and position, (m, 6), at theta_0 and readings (m, L)."""
    T = product(angles + truth.theta_off, truth.s, truth.a, truth.alpha)
    turn = np.stack(
        [T[..., 2, 1] - T[..., 1, 2], T[..., 0, 2] - T[..., 2, 0], T[..., 1, 0] - T[..., 0, 1]], -1
    )
    return np.concatenate((0.5 * turn, T[..., :3, 3]), axis=-1)


def closure_rates(truth: Chain, angles, names):
    """Complex-step derivatives of `closure`: by the angles (m, 6, L) and by `names` (m, 6, P)."""
    h = 1e-40
    by_angle = [
        closure(truth, angles + 1j * h * np.eye(angles.shape[-1])[j]).imag / h
        for j in range(angles.shape[-1])
    ]
    by_name = [closure(_stepped(truth, name, h), angles).imag / h for name in names]
    m = len(angles)
    return (
        np.stack(by_angle, axis=-1),
        np.stack(by_name, axis=-1) if by_name else np.zeros((m, 6, 0)),
    )


def _stepped(truth: Chain, name: str, h: float) -> Chain:
    column, row = name.rsplit("_", 1)
    values = getattr(truth, column).astype(complex)
    values[int(row)] += 1j * h
    return replace(truth, **{column: values})


def closed_poses(
    truth: Truth,
    rng: np.random.Generator,
    count: int,
    *,
    spread_deg: float = 45.0,
    box_deg: float = 60.0,
    give: np.ndarray | None = None,
):
    """Random closed poses around home, with deflections `give` (count, 6): theta_0 and readings (count, L)."""
    links = len(truth.s)
    home = np.concatenate(([0.0], truth.home))
    T = product(home + truth.theta_off, truth.s, truth.a, truth.alpha)
    home[0] = -np.arctan2(T[1, 0], T[0, 0])
    offsets = np.zeros((count, 6)) if give is None else give
    poses = np.full((count, links), np.nan)
    while np.isnan(poses).any():
        missing = np.repeat(np.flatnonzero(np.isnan(poses[:, 0])), 3)
        turn_deg = rng.uniform(-spread_deg, spread_deg, (len(missing), links))
        angles = home + np.deg2rad(turn_deg)
        for _ in range(25):
            error = closure(truth, angles) - offsets[missing]
            if np.abs(error).max() < 1e-15:
                break
            J, _ = closure_rates(truth, angles, ())
            step = (np.linalg.pinv(J) @ error[..., None])[..., 0]
            longest = np.maximum(np.abs(step).max(-1), 1e-300)
            angles -= step * np.minimum(1.0, 0.3 / longest)[:, None]
        T = product(angles + truth.theta_off, truth.s, truth.a, truth.alpha)
        good = (
            (np.abs(closure(truth, angles) - offsets[missing]).max(-1) < 1e-14)
            & (np.trace(T[..., :3, :3], axis1=-2, axis2=-1) > 2.0)
            & (np.abs(angles - home)[:, 1:].max(-1) < np.deg2rad(box_deg))
        )
        poses[missing[good]] = angles[good]
    return poses


def information(truth: Chain, angles, names, variance, *, unsensed=(), give=None):
    """Fisher information (P, P) of `names` from readings with `variance` (n,), rad^2.

    The angles of `unsensed` joints and of the hinge are nuisance parameters of each pose; `give` (6,) is the variance
    of the closure.
    """
    by_angle, by_name = closure_rates(truth, angles, names)
    total = np.zeros((len(names), len(names)))
    nuisance = [0, *unsensed]
    sensed = [j for j in range(1, len(truth.s)) if j not in unsensed]
    for Jt, Jp in zip(by_angle, by_name, strict=True):
        V = (Jt[:, sensed] * np.asarray(variance)[[j - 1 for j in sensed]]) @ Jt[:, sensed].T
        V = V + (0.0 if give is None else np.diag(give))
        # Project onto the directions that the nuisance angles cannot move.
        E = np.linalg.svd(Jt[:, nuisance])[0][:, len(nuisance) :]
        A = E.T @ Jp
        total += A.T @ np.linalg.solve(E.T @ V @ E, A)
    return total


def cramer_rao(truth: Chain, angles, names, variance, **kwargs) -> np.ndarray:
    """Smallest covariance (P, P) of any unbiased estimate of `names`."""
    return np.linalg.inv(information(truth, angles, names, variance, **kwargs))
