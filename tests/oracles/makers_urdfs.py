"""Arms with geometric errors as URDFs, simulated in ball and hinge fixtures by pinocchio."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from tests.oracles.makers_chains import CHAINS, ur
from tests.oracles.urdfs import joint, robot, words

CHAINS = CHAINS | {"ur5": ur(0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823)}
RANGE_RAD = 2.8
LENGTH_M, TWIST_RAD, PARALLEL_TWIST_RAD, OFFSET_RAD = (
    0.5e-3, np.deg2rad(0.1), np.deg2rad(0.05), np.deg2rad(1.0),
)  # fmt: skip
COUNT_RAD = 2.0 * np.pi / 400_000
TIP = np.array([0.0, 0.0, 0.1])


@dataclass(frozen=True)
class Steps:
    """Poses (n + 1, 4, 4) of every joint and of the flange on the link before; the joints' axes (n, 3)."""

    places: np.ndarray
    axes: np.ndarray

    def urdf(self) -> str:
        joints, parent = [], "base"
        for k, place in enumerate(self.places):
            turns = k < len(self.axes)
            link = f"link_{k + 1}" if turns else "flange"
            rpy = Rotation.from_matrix(place[:3, :3]).as_euler("xyz", suppress_warnings=True)
            joints.append(
                joint(
                    f"to_{link}",
                    parent,
                    link,
                    words(place[:3, 3]),
                    words(rpy),
                    words(self.axes[k]) if turns else "",
                    kind="revolute" if turns else "fixed",
                    ends=(-RANGE_RAD, RANGE_RAD),
                    effort=50,
                )
            )
            parent = link
        return robot(*joints)


def nominal(name: str) -> Steps:
    places = np.tile(np.eye(4), (len(CHAINS[name]), 1, 1))
    for place, (xyz, rpy, _) in zip(places, CHAINS[name], strict=True):
        place[:3, :3] = Rotation.from_euler("xyz", rpy, degrees=True).as_matrix()
        place[:3, 3] = xyz
    return Steps(places, np.array([axis for *_, axis in CHAINS[name][:-1]], float))


def built(steps: Steps, rng: np.random.Generator, size: float) -> Steps:
    """The chain with random errors of twists, lengths and zeros, `size` times the constants above."""
    places = steps.places.copy()
    for k, axis in enumerate(steps.axes):
        previous_axis = places[k, :3, :3].T @ (steps.axes[k - 1] if k else axis)
        parallel = k > 0 and np.linalg.norm(np.cross(previous_axis, axis)) < 1e-6
        across = rng.normal(0.0, PARALLEL_TWIST_RAD if parallel else TWIST_RAD, 3)
        across -= axis * (axis @ across)
        rotation = (size * across if k else 0.0) + axis * rng.normal(0.0, OFFSET_RAD if k else 0.0)
        places[k, :3, 3] += rng.normal(0.0, size * LENGTH_M if k else 0.0, 3)
        places[k, :3, :3] = places[k, :3, :3] @ Rotation.from_rotvec(rotation).as_matrix()
    return Steps(places, steps.axes)


@dataclass(frozen=True)
class Held:
    """A point (m) and a direction (zeros: none) of the hand or the ground."""

    point: np.ndarray
    direction: np.ndarray


class Chain:
    """Forward kinematics and Jacobian of a chain's URDF, by pinocchio."""

    def __init__(self, steps: Steps) -> None:
        self.model = pin.buildModelFromXML(steps.urdf())
        self.data = self.model.createData()
        self.flange = self.model.getFrameId("flange")

    def flange_of(self, q: np.ndarray) -> np.ndarray:
        pin.framesForwardKinematics(self.model, self.data, q)
        return self.data.oMf[self.flange].homogeneous.copy()

    def closed(self, hand: Held, ground: Held, rng, near: np.ndarray, box_rad: float) -> np.ndarray:
        """Joint angles (n,), within `box_rad` of `near`, at which the hand's point and direction are the ground's."""
        low, high = np.maximum(near - box_rad, -RANGE_RAD), np.minimum(near + box_rad, RANGE_RAD)
        across = np.linalg.svd(ground.direction[None])[2][1:]
        for _ in range(2000):
            q = rng.uniform(low, high)
            for _ in range(30):
                T = self.flange_of(q)
                J = pin.computeFrameJacobian(
                    self.model, self.data, q, self.flange, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
                )
                lever, direction = T[:3, :3] @ hand.point, T[:3, :3] @ hand.direction
                error = np.concatenate((T[:3, 3] + lever - ground.point, across @ direction))
                rates = np.vstack(
                    (J[:3] - pin.skew(lever) @ J[3:], -across @ pin.skew(direction) @ J[3:])
                )
                rows = slice(None) if hand.direction.any() else slice(3)
                step = np.linalg.lstsq(rates[rows], error[rows], rcond=None)[0]
                q = q - step * min(1.0, 0.5 / max(np.abs(step).max(), 1e-300))
                if np.abs(step).max() < 1e-12:
                    break
            if np.abs(error[rows]).max() < 1e-10 and np.all((low < q) & (q < high)):
                return q
        raise RuntimeError("no closed pose")


def read(q: np.ndarray, rng: np.random.Generator, amplitude_rad: float) -> np.ndarray:
    """Encoder readings of joint angles, with eccentricity and counts."""
    size = rng.normal(0.0, amplitude_rad, (2, q.shape[1]))
    harmonics = size[0] * np.sin(q) + size[1] * np.cos(q)
    return np.round((q + harmonics) / COUNT_RAD) * COUNT_RAD
