"""Gravity in a serial arm: torque about every joint, linear in the mass and first moment of each link.

A link's weight enters only through its mass m and its first moment h = m c (mass times centre), and both
enter linearly (Khalil & Dombre, *Modeling, Identification and Control of Robots*, 2002, section 9.4:
the gravity part of the dynamic model). The generalised force of gravity on joint j, from all links k >= j, is

    tau_j = sum_k  z_{j-1} . ((p_{k-1} - p_{j-1}) m_k + R_k h_k) x g,

with z_{j-1} and p_{j-1} the axis of joint j and a point on it, and g the gravity vector. The centre of mass of link k
is expressed relative to p_{k-1}, in axes R_k: frame k-1 rotated about the axis of joint k by ``theta + theta_off``. So
the centre does not depend on the link's own length or twist, which the fixture determines for the first and last link.
The torque that holds the arm up is ``-tau``: the g(q) of most textbooks and of pinocchio's
``computeGeneralizedGravity``.
"""

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, frozen
from solver.chain.kinematics import Frames
from solver.chain.rotations import skew

STANDARD_GRAVITY_M_PER_S2 = 9.80665


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinkMasses:
    """Masses of links 1..n of an arm, their uncertainty, and the direction of gravity.

    `mass_kg`, `mass_sd_kg` (n,): masses, and their standard deviations.
    `centre_m` (n, 3): centre of mass of each link j relative to p_{j-1}, in the axes R_j (see the module).
    `centre_sd_m` (n,): standard deviation of each component of the centre of mass.
    `down` (3,): unit vector along gravity in frame 0, the arm's base.
    `down_sd_rad`: standard deviation of the base's tilt about each horizontal axis.
    """

    mass_kg: FloatArray
    centre_m: FloatArray
    mass_sd_kg: FloatArray
    centre_sd_m: FloatArray
    down: FloatArray
    down_sd_rad: float = 0.0

    def __post_init__(self) -> None:
        for name in ("mass_kg", "centre_m", "mass_sd_kg", "centre_sd_m", "down"):
            object.__setattr__(self, name, frozen(getattr(self, name)))

    @property
    def moments(self) -> FloatArray:
        """Mass (kg), then first moment (kg m) of each link, (n, 4); the torque is `torque_rates` times these values."""
        return np.column_stack((self.mass_kg, self.mass_kg[:, None] * self.centre_m))

    @property
    def moments_sd(self) -> FloatArray:
        """Square roots (n, 4, 4) of the covariance matrices of the rows of `moments`.

        With z ~ N(0, I), ``moments_sd @ z`` are errors of the rows: an error of the mass changes mass and first moment
        (h = m c), an error of the centre changes the first moment only.
        """
        root = np.zeros((len(self.mass_kg), 4, 4))
        root[:, 0, 0] = self.mass_sd_kg
        root[:, 1:, 0] = self.mass_sd_kg[:, None] * self.centre_m
        root[:, range(1, 4), range(1, 4)] = (self.mass_kg * self.centre_sd_m)[:, None]
        return root

    @property
    def tilted(self) -> FloatArray:
        """Changes (2, 3) of `down` if the base tilts by one standard deviation, about each of two horizontal axes."""
        across = np.linalg.svd(self.down[None])[2][1:]
        return self.down_sd_rad * across


UNSTATED_KG, UNSTATED_CENTRE_M = 1.0, 0.1
"""Mass of each link, and standard deviation of its centre of mass, if no file states masses. They determine only
how sag varies from pose to pose; the magnitude of sag is stated separately."""

UPRIGHT_DOWN = 0.0, 0.0, -1.0
"""Direction of gravity in frame 0 of an arm that stands upright, if no file states another."""


def unstated_masses(links: int, down: tuple[float, float, float]) -> LinkMasses:
    """Return default masses: equal, with 100 % uncertainty, centred at the joints; `down`: see `LinkMasses`."""
    each = np.full(links, UNSTATED_KG)
    return LinkMasses(
        mass_kg=each,
        centre_m=np.zeros((links, 3)),
        mass_sd_kg=each,
        centre_sd_m=np.full(links, UNSTATED_CENTRE_M),
        down=np.array(down),
    )


def torque_rates(arm: Frames, down: FloatArray) -> FloatArray:
    """Gravity's torque about every joint per unit of every link's mass and first moment.

    `arm`: frames 0..n of links 1..n, in frame 0. `down`: unit vector along gravity in frame 0, (3,), or d vectors
    (d, 3). The result is (..., n, n, 4), or (d, ..., n, n, 4) for several vectors. Its axes are joint, link, and the
    quantity: mass (N m / kg), then x, y, z of the first moment (N m / kg m). Links before a joint have rates of 0.
    """
    axes, origins = arm.axes, arm.origins_m
    z, x, p = axes[..., :-1, :, 2], arm.normals[..., 1:, :], origins[..., :-1, :]
    n = z.shape[-2]
    link_axes = np.stack((x, np.cross(z, x), z), axis=-2)
    weight = STANDARD_GRAVITY_M_PER_S2 * skew(np.asarray(down))
    weight = weight.reshape(*weight.shape[:-2], *(1 for _ in z.shape[:-2]), 3, 3)
    # z . (r x g) = (g x z) . r: one vector for each joint, then a scalar product with each lever.
    by_lever = z @ np.swapaxes(weight, -1, -2)
    rates = np.empty((*by_lever.shape[:-1], n, 4))
    of_moment = by_lever @ np.swapaxes(link_axes.reshape(*z.shape[:-2], 3 * n, 3), -1, -2)
    rates[..., 1:] = of_moment.reshape(*by_lever.shape[:-1], n, 3)
    # A joint's lever to its own link is exactly zero.
    levers = by_lever @ np.swapaxes(p, -1, -2)
    rates[..., 0] = levers - np.diagonal(levers, axis1=-2, axis2=-1)[..., None]
    rates *= np.triu(np.ones((n, n)))[..., None]
    return rates
