"""Deflections of the simulated arms: gravity twists the joints and loads the hinge.

Gravity compensation carries the arm, so every joint twists by its gravity torque. The hinge carries the torque error
of the compensation (joints in free mode carry none), and deflects by its compliance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tests.oracles.shop_floor_chain import LINKS, Chain, frames, rotation_about_z, screws

G_M_PER_S2 = 9.81
PASSIVE = (2, 3, 4, 6, 7)
"""Joints in free mode while joints 1 and 5 drive."""

FRICTION = 0.1


@dataclass(frozen=True, kw_only=True)
class Masses:
    """Mass (8,) of links 0..7 in kg and their centres (8, 3) in frames 0..7, m."""

    mass: np.ndarray
    centre: np.ndarray

    @classmethod
    def drawn(cls, chain: Chain, rng: np.random.Generator) -> Masses:
        """An upper arm, a forearm, a hand with its half of the hinge, and small links between them."""
        mass = np.array([0.0, 1.5, 1.0, 4.0, 0.8, 2.5, 0.5, 1.6]) * np.maximum(
            1.0 + 0.2 * rng.normal(size=LINKS), 0.4
        )
        centre = rng.normal(size=(LINKS, 3)) * 0.015
        for link, share in ((3, 0.5), (5, 0.55), (7, 0.5)):
            tilt = chain.alpha[link]
            link_axis = np.array([0.0, np.sin(tilt), np.cos(tilt)]) * chain.s[link]
            centre[link] -= share * (link_axis + np.array([chain.a[link], 0.0, 0.0]))
        return cls(mass=mass, centre=centre)

    def with_errors(self, rng: np.random.Generator) -> Masses:
        """Return these masses with the errors of a gravity compensation."""
        return Masses(
            mass=self.mass * (1.0 + 0.15 * rng.normal(size=LINKS)),
            centre=self.centre + 0.01 * rng.normal(size=(LINKS, 3)),
        )

    def torque(self, T: np.ndarray, down: np.ndarray) -> np.ndarray:
        weight = T[:, 1, :3, :3] @ (down * G_M_PER_S2)
        out = np.zeros((len(T), LINKS))
        for link in range(1, LINKS):
            centre = T[:, link + 1, :3, 3] + (T[:, link + 1, :3, :3] @ self.centre[link])
            for joint in range(1, link + 1):
                arm = np.cross(centre - T[:, joint, :3, 3], self.mass[link] * weight)
                out[:, joint] += np.einsum("mi,mi->m", T[:, joint, :3, 2], arm)
        return out


def hinge_wrench(T: np.ndarray, torque: np.ndarray, *, rub: float = FRICTION) -> np.ndarray:
    """Moment over force (m, 6) on the hand, in the hinge frame, that carries `torque` (m, 8).

    A hinge carries no moment about its axis. `rub`, friction of the passive joints (N m for each N m and N at the
    hinge), keeps the wrench finite near a singularity.
    """
    J = screws(T)[:, :, list(PASSIVE)]
    constrained = [0, 1, 3, 4, 5]
    K = J[:, constrained]
    Kt = np.swapaxes(K, -1, -2)
    passive_torque = -(K @ torque[:, list(PASSIVE), None])
    out = np.zeros((len(T), 6))
    out[:, constrained] = np.linalg.solve(K @ Kt + rub**2 * np.eye(5), passive_torque)[..., 0]
    return out


@dataclass(frozen=True, kw_only=True)
class Load:
    """Joint sag `sag` (8,), rad per N m, and compliances (6, 6) of the hinge's halves on table and hand."""

    masses: Masses
    stated_masses: Masses
    down: np.ndarray
    sag: np.ndarray
    ground: np.ndarray
    hand: np.ndarray

    @classmethod
    def drawn(
        cls,
        chain: Chain,
        workspace: np.ndarray,
        rng: np.random.Generator,
        *,
        sag_rad: float,
        give_rad: float,
        give_m: float,
    ) -> Load:
        """Masses and compliances with the given rms sizes over `workspace` (k, 8).

        Each joint's sag is half-normal with this second moment.
        """
        masses = Masses.drawn(chain, rng)
        down = np.array([-1.0, 0.0, 0.0]) + 0.05 * rng.normal(size=3)
        unscaled = cls(
            masses=masses,
            stated_masses=masses.with_errors(rng),
            down=down / np.linalg.norm(down),
            sag=np.zeros(LINKS),
            ground=_compliance(rng),
            hand=0.3 * _compliance(rng),
        )
        T = frames(chain, workspace)
        torque = np.sqrt(np.mean(unscaled.torque(T) ** 2, axis=0))
        sag = np.zeros(LINKS)
        scale = _compliance_scale(unscaled, T, workspace, np.array([give_rad, give_m]))
        # Drawn last, so that all else is independent of it.
        sag[1:] = sag_rad * np.abs(rng.normal(size=LINKS - 1)) / np.maximum(torque[1:], 1e-9)
        return replace(
            unscaled,
            sag=sag,
            ground=scale @ unscaled.ground @ scale,
            hand=scale @ unscaled.hand @ scale,
        )

    def torque(self, T: np.ndarray) -> np.ndarray:
        return self.masses.torque(T, self.down)

    def wrenches(self, T: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Moments over forces (2, m, 6) on the hinge's halves on table and hand."""
        on_hand = hinge_wrench(T, self.torque(T) - self.stated_masses.torque(T, self.down))
        turn = np.swapaxes(rotation_about_z(angles[:, 0])[:, :3, :3], -1, -2)
        on_table = -np.concatenate(
            [(turn @ on_hand[:, r : r + 3, None])[..., 0] for r in (0, 3)], axis=-1
        )
        return np.stack((on_table, on_hand))

    def give(self, T: np.ndarray, angles: np.ndarray) -> np.ndarray:
        """Displacements (2, m, 6) of the hinge's halves on table and hand."""
        on_table, on_hand = self.wrenches(T, angles)
        return np.stack((on_table @ self.ground.T, on_hand @ self.hand.T))


def _compliance_scale(
    unscaled: Load, T: np.ndarray, angles: np.ndarray, required: np.ndarray
) -> np.ndarray:
    """Diagonal S (6, 6) with which compliances S C S deflect by `required` (rad, m), rms of a component."""
    wrenches = unscaled.wrenches(T, angles)
    scale = np.where(required > 0.0, 1.0, 0.0)
    for _ in range(60):
        S = np.diag(np.repeat(scale, 3))
        mean_square = np.zeros(2)
        for C, F in zip((unscaled.ground, unscaled.hand), wrenches, strict=True):
            deflection = F @ (S @ C @ S).T
            mean_square += [np.mean(deflection[:, :3] ** 2), np.mean(deflection[:, 3:] ** 2)]
        # Both halves share a scale, so that the compliance remains symmetric.
        scale = scale * (required / np.sqrt(np.maximum(mean_square, 1e-300))) ** 0.6
    return np.diag(np.repeat(scale, 3))


def _compliance(rng: np.random.Generator) -> np.ndarray:
    """Random symmetric positive definite compliance (6, 6) of a slender bracket: rad and m per N m and N."""
    L = rng.normal(size=(6, 6)) + 1.5 * np.eye(6)
    S = np.diag([3e-5] * 3 + [1e-5] * 3)
    return S @ (L @ L.T) @ S / np.mean(np.diag(S @ S))
