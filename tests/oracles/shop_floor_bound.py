"""Cramer-Rao bound of linear estimates of the simulated arms of `shop_floor`. Shares no code with `solver`.

The closures of all poses are linear in the parameters, joint errors, lengths, twists and deflections (derivatives
by complex step, `loop_oracle`). Each source enters with its second moments: exact where it is a few numbers, sampled
where it is a curve or a load. Too small a sample makes the bound too low: by 1.2 % with as many loads as equations
(200), 0.3 % with four times as many.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.linalg import block_diag

from tests.oracles.loop_oracle import closure_rates
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
    draw_rvdt,
)
from tests.oracles.shop_floor_chain import (
    FOLLOW,
    LINKS,
    Loop,
    frames,
    nominal_chain,
    nominal_chart,
    rotation_about_z,
)
from tests.oracles.shop_floor_load import G_M_PER_S2, Load, Masses, hinge_wrench
from tests.oracles.shop_floor_sensors import Rvdt

DRAWS = 2000
"""Size of the samples of loads and curves: ten for each equation of 40 poses."""


def bound(session: Session, sizes: Sizes) -> np.ndarray:
    """Standard deviations (14,) of the best linear estimate from the poses of a session."""
    return np.sqrt(np.diagonal(covariance(session, sizes)))


def covariance(session: Session, sizes: Sizes) -> np.ndarray:
    rates, V, _ = _equations(session, sizes)
    return np.linalg.inv(rates.T @ np.linalg.solve(V, rates))


def step_sigma(session: Session, sizes: Sizes) -> np.ndarray:
    """Standard deviation (7, m) of the best estimate of a step (rad) of joint j's reading at pose k.

    Joint and pose are known to the estimate; infinite for k = 0, where a step is an offset.
    """
    rates, V, B = _equations(session, sizes)
    root = np.linalg.cholesky(V)
    Q = np.linalg.qr(np.linalg.solve(root, rates))[0]
    sigma = np.full((B.shape[-1], len(B)), np.inf)
    for j, k in np.ndindex(sigma.shape):
        column = B[:, :, j].copy()
        column[:k] = 0.0
        white = np.linalg.solve(root, column.ravel())
        if k:
            sigma[j, k] = 1.0 / np.linalg.norm(white - Q @ (Q.T @ white))
    return sigma


def _equations(session: Session, sizes: Sizes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Jacobian of the closures by parameters (5 m, 14), their covariance, and Jacobian by angles (m, 5, 7).

    The poses are closed without deflections, whose effect on the derivatives is negligible.
    """
    chain = session.specimen.chain
    angles, _ = Loop(chain=chain).closed(session.angles, free=FOLLOW)
    truth = replace(chain, theta_off=np.zeros(8))
    by_angle, by_entry = closure_rates(truth, angles, (*PARAMETERS, *LENGTHS, *TWISTS))
    # Five combinations of each closure that do not depend on the hinge angle.
    rows = np.stack([np.linalg.svd(J[:, :1])[0][:, 1:].T for J in by_angle])
    A, B = rows @ by_entry, rows @ by_angle[:, :, 1:]
    rates, tolerance_rates = np.split(A, [len(PARAMETERS)], axis=-1)
    size = np.repeat([sizes.length_m, sizes.twist_rad], [len(LENGTHS), len(TWISTS)])
    effects = [
        tolerance_rates * size,
        _sensors(B, (angles - chain.theta_off)[:, 1:], sizes),
        _play(B, angles, sizes),
        _loads(rows, B, angles, sizes),
    ]
    V = _independent_covariance(rows, B, sizes, int(session.samples[0]))
    for effect in effects:
        Z = effect.reshape(len(V), -1)
        V = V + Z @ Z.T
    return rates.reshape(len(V), -1), V, B


def _independent_covariance(
    rows: np.ndarray, B: np.ndarray, sizes: Sizes, samples: int
) -> np.ndarray:
    """Covariance (5 m, 5 m) of errors that are independent in each pose: counts, noise, hinge scatter."""
    variance = np.full(7, (2.0 * np.pi / COUNTS_PER_REV) ** 2 / 12.0)
    lsb = FULL_SCALE / 2**BITS
    variance[[j - 1 for j in RVDTS]] = lsb**2 * (sizes.noise_lsb**2 + 1.0 / 12.0) / samples
    give = (SCATTER * np.repeat([sizes.give_rad, sizes.give_m], 3)) ** 2
    return block_diag(
        *((b * variance) @ b.T + (r * give) @ r.T for r, b in zip(rows, B, strict=True))
    )


def _sensors(B: np.ndarray, at_sensor: np.ndarray, sizes: Sizes) -> np.ndarray:
    """Columns (m, 5, k) of encoder harmonics, RVDT gains and curves, scaled by their sizes."""
    shapes = []
    for j in ENCODERS:
        x = at_sensor[:, j - 1]
        turns = np.stack([np.cos(x), np.sin(x), np.cos(2.0 * x), np.sin(2.0 * x)], axis=-1)
        shapes.append(B[:, :, j - 1, None] * (sizes.encoder_rad * turns[:, None]))
    for j in RVDTS:
        gain_error = sizes.gain * (at_sensor[:, j - 1] - _rvdts(j)[0].zero)
        shapes.append(B[:, :, j - 1, None] * gain_error[:, None, None])
        curves = np.stack([rvdt.deviation(at_sensor[:, j - 1]) for rvdt in _rvdts(j)], axis=-1)
        curves = curves * (sizes.linearity / np.sqrt(DRAWS))
        shapes.append(B[:, :, j - 1, None] * curves[:, None])
    return np.concatenate(shapes, axis=-1)


def _play(B: np.ndarray, angles: np.ndarray, sizes: Sizes) -> np.ndarray:
    """Columns (m, 5, k) of every joint's backlash, by the sign of sampled loads and by direction of approach."""
    if not sizes.backlash_rad:
        return B[..., :0]
    masses, down = _every_mass()
    load_sign = np.sign(_torques(frames(nominal_chain(), angles), masses, down)[:, 1:])
    approach_sign = np.sign(np.diff(angles, axis=0, prepend=angles[:1])[:, 1:, None])
    size = sizes.backlash_rad * np.sqrt(0.5)
    sides = np.concatenate((load_sign / np.sqrt(load_sign.shape[-1]), approach_sign), axis=-1)
    return (B[..., None] * (size * sides)[:, None]).reshape(*B.shape[:2], -1)


def _torques(T: np.ndarray, moments: np.ndarray, down: np.ndarray) -> np.ndarray:
    """Gravity torques (m, 8, d) of masses and first moments (d, 8, 4), `down` (d, 3) in the base."""
    base_rotation, rates = T[:, 1, :3, :3], np.zeros((len(T), LINKS, LINKS, 4, 3))
    for link in range(1, LINKS):
        for joint in range(1, link + 1):
            lever = np.empty((len(T), 4, 3))
            lever[:, 0] = T[:, link + 1, :3, 3] - T[:, joint, :3, 3]
            lever[:, 1:] = np.swapaxes(T[:, link + 1, :3, :3], -1, -2)
            rates[:, joint, link] = np.cross(T[:, joint, None, :3, 2], lever) @ base_rotation
    weight = G_M_PER_S2 * np.einsum("dlk,dc->dlkc", moments, down)
    return (rates.reshape(len(T) * LINKS, -1) @ weight.reshape(len(down), -1).T).reshape(
        len(T), LINKS, -1
    )


def _loads(rows: np.ndarray, B: np.ndarray, angles: np.ndarray, sizes: Sizes) -> np.ndarray:
    """Columns (m, 5, k) of deflections and of every joint's sag, under sampled loads."""
    if not (sizes.sag_rad or sizes.give_rad or sizes.give_m):
        return B[..., :0]
    T = frames(nominal_chain(), angles)
    loads = _every_load()
    torque = _torques(T, loads.masses, loads.down)
    sag = sizes.sag_rad * loads.sag.T * torque
    rotation = np.zeros((len(angles), 6, 6))
    rotation[:, :3, :3] = rotation[:, 3:, 3:] = rotation_about_z(angles[:, 0])[:, :3, :3]
    # The wrench is linear in the torque error of the gravity compensation.
    torque_error = torque - _torques(T, loads.stated_moments, loads.down)
    unit = np.stack([hinge_wrench(T, np.tile(u, (len(T), 1))) for u in np.eye(LINKS)], axis=-1)
    on_hand = unit @ torque_error
    on_table = rotation @ np.einsum(
        "dij,mjd->mid", loads.ground, -np.swapaxes(rotation, -1, -2) @ on_hand
    )
    deflection = on_table + np.einsum("dij,mjd->mid", loads.hand, on_hand)
    deflection *= np.repeat([sizes.give_rad, sizes.give_m], 3)[:, None]
    twist = (B[..., None] * sag[:, None, 1:]).reshape(*B.shape[:2], -1)
    return np.concatenate((twist, rows @ deflection), axis=-1) / np.sqrt(len(loads.down))


@cache
def _rvdts(joint: int) -> tuple[Rvdt, ...]:
    """RVDTs of linearity 1 and exact gain."""
    rng = np.random.default_rng([5, joint])
    return tuple(
        draw_rvdt(joint, rng, linearity=1.0, noise_lsb=0.0, gain=0.0) for _ in range(DRAWS)
    )


@dataclass(frozen=True, kw_only=True)
class _Loads:
    """Stacked `Load`s: masses and first moments (d, 8, 4), true and as the compensation has them, and the rest."""

    masses: np.ndarray
    stated_moments: np.ndarray
    down: np.ndarray
    sag: np.ndarray
    ground: np.ndarray
    hand: np.ndarray


def _moments(masses: list[Masses]) -> np.ndarray:
    """Mass and mass times centre of every link, (d, 8, 4)."""
    centred = [np.column_stack((np.ones(LINKS), one.centre)) for one in masses]
    return np.stack([one.mass[:, None] * c for one, c in zip(masses, centred, strict=True)])


@cache
def _every_load() -> _Loads:
    """Loads of size 1: rad of sag, rad and m of deflection."""
    smooth = np.sqrt(1.0 - SCATTER**2)
    loads = [
        Load.drawn(
            nominal_chain(),
            nominal_chart().angles,
            np.random.default_rng([6, k]),
            sag_rad=1.0,
            give_rad=smooth,
            give_m=smooth,
        )
        for k in range(DRAWS)
    ]
    return _Loads(
        masses=_moments([load.masses for load in loads]),
        stated_moments=_moments([load.stated_masses for load in loads]),
        **{name: np.stack([getattr(load, name) for load in loads])
           for name in ("down", "sag", "ground", "hand")},
    )  # fmt: skip


@cache
def _every_mass() -> tuple[np.ndarray, np.ndarray]:
    """Masses and first moments (d, 8, 4) of sampled loads, and directions of gravity (d, 3)."""
    rngs = [np.random.default_rng([7, k]) for k in range(DRAWS)]
    masses = _moments([Masses.drawn(nominal_chain(), rng) for rng in rngs])
    down = np.array([-1.0, 0.0, 0.0]) + 0.05 * np.array([rng.normal(size=3) for rng in rngs])
    return masses, down / np.linalg.norm(down, axis=-1, keepdims=True)
