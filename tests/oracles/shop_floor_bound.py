"""The least error that any linear estimate of the shop floor's arms can have: their Cramer-Rao bound.

The closures of all poses, linear in the parameters, in joint errors, in lengths and twists and in what
the hinge gives; derivatives by complex step (`loop_oracle`). Every source enters with its second moments
as the generator draws them: exact where it is a few numbers, sampled where it is a curve or a load.
Shares no code with `solver`.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.linalg import block_diag

from tests.oracles.loop_oracle import Truth, closure_rates
from tests.oracles.shop_floor import (
    BITS,
    COUNTS_PER_REV,
    ENCODERS,
    FULL_SCALE,
    LENGTHS,
    PARAMETERS,
    RVDTS,
    SCATTER,
    TWISTS,
    Session,
    Sizes,
    drawn_rvdt,
)
from tests.oracles.shop_floor_chain import Loop, frames, rotation_about_z
from tests.oracles.shop_floor_load import Load, Masses
from tests.oracles.shop_floor_sensors import Rvdt
from tests.oracles.shop_floor_walk import FOLLOW, nominal_chain, nominal_chart

DRAWS = 200
"""Loads and curves of which second moments are taken."""


def bound(taken: Session, sizes: Sizes) -> np.ndarray:
    """Standard deviations (14,) of the best linear estimate from the poses of a session."""
    return np.sqrt(np.diagonal(covariance(taken, sizes)))


def covariance(taken: Session, sizes: Sizes) -> np.ndarray:
    """Covariance (14, 14) of the best linear estimate."""
    hard, V, _ = _equations(taken, sizes)
    return np.linalg.inv(hard.T @ np.linalg.solve(V, hard))


def step_sigma(taken: Session, sizes: Sizes) -> np.ndarray:
    """Standard deviation (7, m) of the best estimate of a shift (rad) of joint j's reading from pose k on.

    Of one that knows joint and pose; infinite for k = 0, where a shift is an offset.
    """
    hard, V, B = _equations(taken, sizes)
    root = np.linalg.cholesky(V)
    Q = np.linalg.qr(np.linalg.solve(root, hard))[0]
    found = np.full((B.shape[-1], len(B)), np.inf)
    for j, k in np.ndindex(found.shape):
        column = B[:, :, j].copy()
        column[:k] = 0.0
        white = np.linalg.solve(root, column.ravel())
        if k:
            found[j, k] = 1.0 / np.linalg.norm(white - Q @ (Q.T @ white))
    return found


def _equations(taken: Session, sizes: Sizes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rates of the closures with the parameters (5 m, 14), their covariance, and rates with angles (m, 5, 7).

    The poses are taken as closed without give: what gives changes no derivative that matters.
    """
    chain = taken.specimen.chain
    angles, _ = Loop(chain=chain).closed(taken.angles, free=FOLLOW)
    truth = Truth(theta_off=np.zeros(8), s=chain.s, a=chain.a, alpha=chain.alpha, home=np.zeros(7))
    by_angle, by_entry = closure_rates(truth, angles, (*PARAMETERS, *LENGTHS, *TWISTS))
    # Five combinations of each closure that the hinge's own angle does not move.
    rows = np.stack([np.linalg.svd(J[:, :1])[0][:, 1:].T for J in by_angle])
    A, B = rows @ by_entry, rows @ by_angle[:, :, 1:]
    hard, soft = np.split(A, [len(PARAMETERS)], axis=-1)
    size = np.repeat([sizes.length_m, sizes.twist_rad], [len(LENGTHS), len(TWISTS)])
    effects = [
        soft * size,
        _sensors(B, (angles - chain.theta_off)[:, 1:], sizes),
        _play(B, angles, sizes),
        _loads(rows, B, angles, sizes),
    ]
    V = _anew(rows, B, sizes, int(taken.samples[0]))
    for effect in effects:
        Z = effect.reshape(len(V), -1)
        V = V + Z @ Z.T
    return hard.reshape(len(V), -1), V, B


def _anew(rows: np.ndarray, B: np.ndarray, sizes: Sizes, samples: int) -> np.ndarray:
    """Covariance (5 m, 5 m) of what is anew in every pose: counts, noise, scatter of the hinge."""
    variance = np.full(7, (2.0 * np.pi / COUNTS_PER_REV) ** 2 / 12.0)
    lsb = FULL_SCALE / 2**BITS
    variance[[j - 1 for j in RVDTS]] = lsb**2 * (sizes.noise_lsb**2 + 1.0 / 12.0) / samples
    give = (SCATTER * np.repeat([sizes.give_rad, sizes.give_m], 3)) ** 2
    return block_diag(
        *((b * variance) @ b.T + (r * give) @ r.T for r, b in zip(rows, B, strict=True))
    )


def _sensors(B: np.ndarray, at_sensor: np.ndarray, sizes: Sizes) -> np.ndarray:
    """Columns (m, 5, k) of encoder harmonics and RVDT curves, times their sizes."""
    shapes = []
    for j in ENCODERS:
        x = at_sensor[:, j - 1]
        turns = np.stack([np.cos(x), np.sin(x), np.cos(2.0 * x), np.sin(2.0 * x)], axis=-1)
        shapes.append(B[:, :, j - 1, None] * (sizes.encoder_rad * turns[:, None]))
    for j in RVDTS:
        curves = np.stack([rvdt.deviation(at_sensor[:, j - 1]) for rvdt in _rvdts(j)], axis=-1)
        curves = curves * (sizes.linearity / np.sqrt(DRAWS))
        shapes.append(B[:, :, j - 1, None] * curves[:, None])
    return np.concatenate(shapes, axis=-1)


def _play(B: np.ndarray, angles: np.ndarray, sizes: Sizes) -> np.ndarray:
    """Columns (m, 5, 14) of every joint's play, by the load's sign and by the way it came."""
    masses = Masses.drawn(nominal_chain(), np.random.default_rng(6))
    torque = masses.torque(frames(nominal_chain(), angles), np.array([-1.0, 0.0, 0.0]))
    came = np.diff(angles, axis=0, prepend=angles[:1])
    sides = [np.sign(side[:, 1:]) for side in (torque, came)]
    size = sizes.backlash_rad * np.sqrt(1.0 / len(sides))
    return np.concatenate([B * (size * side)[:, None] for side in sides], axis=-1)


def _loads(rows: np.ndarray, B: np.ndarray, angles: np.ndarray, sizes: Sizes) -> np.ndarray:
    """Columns (m, 5, k) of give and of every joint's sag, under many loads.

    Files state them joint by joint: nobody knows that one compliance turns with another.
    """
    if not (sizes.sag_rad or sizes.give_rad or sizes.give_m):
        return B[..., :0]
    T = frames(nominal_chain(), angles)
    turn = np.zeros((len(angles), 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = rotation_about_z(angles[:, 0])[:, :3, :3]
    columns = []
    for load in _every_load():
        torque = load.torque(T)[:, 1:]
        columns.append(B * (sizes.sag_rad * load.sag[1:] * torque)[:, None])
        on_table, on_hand = load.give(T, angles)
        give = (turn @ on_table[..., None])[..., 0] + on_hand
        give = give * np.repeat([sizes.give_rad, sizes.give_m], 3)
        columns.append(rows @ give[..., None])
    return np.concatenate(columns, axis=-1) / np.sqrt(DRAWS)


@cache
def _rvdts(joint: int) -> tuple[Rvdt, ...]:
    """Sensors of linearity 1, to be scaled."""
    rng = np.random.default_rng([5, joint])
    return tuple(drawn_rvdt(joint, rng, linearity=1.0, noise_lsb=0.0) for _ in range(DRAWS))


@cache
def _every_load() -> tuple[Load, ...]:
    """Loads of sizes 1, to be scaled: rad of sag, rad and m of give."""
    smooth = np.sqrt(1.0 - SCATTER**2)
    return tuple(
        Load.drawn(
            nominal_chain(),
            nominal_chart().angles,
            np.random.default_rng([6, k]),
            sag_rad=1.0,
            give_rad=smooth,
            give_m=smooth,
        )
        for k in range(DRAWS)
    )
