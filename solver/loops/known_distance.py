"""A distance between two sockets that is known from elsewhere: as a check, or as what sets the scale.

A loop is the same loop at any size: with every length unknown its scale cannot be seen. Two sockets of
one block at a measured distance give it. As a check the distance stays out of the fit and is compared
with what the fit found; as scale, `KnownDistance` moves the second socket on a sphere about the first.
Knows a `ClosureModel` with ground_x, ground_y, ground_z for each placement.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.parameters import Parameter
from solver.loops.closure import ClosureModel, LoopError, ReducedError

AXES = ("ground_x", "ground_y", "ground_z")


@dataclass(frozen=True, slots=True, kw_only=True)
class DistanceCheck:
    """A found distance beside the known one.

    Attributes
    ----------
    found_m, sigma_m
        Distance by the estimate and its standard deviation.
    known_m, known_sigma_m
        Distance by the block's measurement.
    """

    found_m: float
    sigma_m: float
    known_m: float
    known_sigma_m: float

    @property
    def difference_m(self) -> float:
        """Found less known."""
        return self.found_m - self.known_m

    @property
    def deviation(self) -> float:
        """The difference in standard deviations of both together."""
        both = float(np.hypot(self.sigma_m, self.known_sigma_m))
        return self.difference_m / both if both > 0.0 else float("inf")


def check_distance(
    parameters: tuple[Parameter, ...],
    x: FloatArray,
    covariance: FloatArray,
    *,
    between: tuple[int, int],
    distance_m: float,
    sigma_m: float = 0.0,
) -> DistanceCheck:
    """Compare the distance of two sockets with its known value.

    Parameters
    ----------
    parameters, x, covariance
        Of an estimate: (P,), (P,), (P, P).
    between
        Numbers of the two placements.
    distance_m, sigma_m
        What the block measures, and how well.

    Raises
    ------
    ValueError
        If the estimate has no ground point for one of the placements.
    """
    first, second = (_columns(parameters, number) for number in between)
    apart = x[second] - x[first]
    found = float(np.linalg.norm(apart))
    gradient = np.zeros(len(x))
    gradient[second] = apart / found
    gradient[first] = -apart / found
    return DistanceCheck(
        found_m=found,
        sigma_m=float(np.sqrt(max(float(gradient @ covariance @ gradient), 0.0))),
        known_m=distance_m,
        known_sigma_m=sigma_m,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownDistance:
    """A `ClosureModel` in which two sockets are a known distance apart, taken as exact.

    The three coordinates of the second socket become two angles of the direction from the first:
    ``ground_azimuth[b]`` and ``ground_elevation[b]``, zero along the nominal direction. An error of the
    distance passes into every length in proportion, so `distance_m` wants a gauge, not a ruler.

    Attributes
    ----------
    model
        The loops of all placements.
    between
        Numbers of the two placements.
    distance_m
        Distance of their sockets.
    """

    model: ClosureModel
    between: tuple[int, int]
    distance_m: float

    def __post_init__(self) -> None:
        first, second = (_columns(self.model.parameters, number) for number in self.between)
        if not self.distance_m > 0.0 or not set(first.tolist()).isdisjoint(second.tolist()):
            raise ValueError("a known distance is positive and between two placements")
        nominal = np.array([p.nominal for p in self.model.parameters])
        if float(np.linalg.norm(nominal[second] - nominal[first])) == 0.0:
            raise ValueError("the nominal sockets coincide: give the second a nominal direction")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of the loops, with two angles for the second socket's three coordinates."""
        _, second = self._sockets()
        kept = [p for k, p in enumerate(self.model.parameters) if k not in second]
        angles = ("ground_azimuth", "ground_elevation")
        kept += [
            Parameter(name=f"{name}[{self.between[1]}]", is_angle=True, nominal=0.0)
            for name in angles
        ]
        return tuple(kept)

    @property
    def joint_count(self) -> int:
        """Joints of the arm."""
        return self.model.joint_count

    @property
    def unsensed_joints(self) -> tuple[int, ...]:
        """Arm joints (1-based) whose readings are not used."""
        return self.model.unsensed_joints

    @property
    def equations_per_pose(self) -> int:
        """That of the loops: the distance takes an unknown away, it adds no equation to a pose."""
        return self.model.equations_per_pose

    def whole(self, x: FloatArray) -> FloatArray:
        """Values of the loops' own parameters (..., P + 1) for values of these (..., P)."""
        return self._expand(np.asarray(x, dtype=np.float64))[0]

    def loop(self, x: FloatArray, q: FloatArray, u: FloatArray) -> LoopError:
        """Closure error in terms of these parameters."""
        full, rates = self._expand(np.asarray(x, dtype=np.float64))
        error = self.model.loop(full, q, u)
        return replace(error, jac_x=error.jac_x @ rates[..., None, :, :])

    def initial_unsensed(self, x: FloatArray, q: FloatArray) -> FloatArray:
        """First values of the unsensed angles."""
        return self.model.initial_unsensed(self.whole(x), q)

    def reduced(self, x: FloatArray, q: FloatArray) -> ReducedError:
        """Reduced closure error in terms of these parameters."""
        full, rates = self._expand(np.asarray(x, dtype=np.float64))
        error = self.model.reduced(full, q)
        return replace(error, jac_x=error.jac_x @ rates[..., None, :, :])

    def equivalents(self, x: FloatArray) -> FloatArray:
        """The same direction by the other pair of angles, beyond the pole."""
        x = np.asarray(x, dtype=np.float64)
        other = x.copy()
        other[-2:] = x[-2] + np.pi, np.pi - x[-1]
        return np.stack((x, other))

    def with_all_joints_sensed(self) -> KnownDistance:
        """Return the same loops with every joint's reading used and its offset an unknown."""
        # New unknowns of the loops come between these and the angles: names keep them apart.
        return replace(self, model=self.model.with_all_joints_sensed())

    @property
    def ground_side(self) -> tuple[str, ...]:
        """Where the sockets stand."""
        mine = {p.name for p in self.parameters}
        kept = [name for name in self.model.ground_side if name in mine]
        return (*kept, *(p.name for p in self.parameters[-2:]))

    @property
    def hand_side(self) -> tuple[str, ...]:
        """How the hand holds the ball."""
        return self.model.hand_side

    def without(self, names: Collection[str]) -> KnownDistance:
        """Return the same loops with the named unknowns held at their nominal values.

        Raises
        ------
        ValueError
            If a coordinate of the two sockets is named: the distance needs them all.
        """
        first, _ = self._sockets()
        needed = {self.model.parameters[k].name for k in first}
        needed |= {p.name for p in self.parameters[-2:]}
        if needed & set(names):
            raise ValueError("the two sockets at a known distance cannot be held")
        return replace(self, model=self.model.without(names))

    def at_poses(self, poses: IntArray) -> KnownDistance:
        """Return the model of a selection of poses."""
        return replace(self, model=self.model.at_poses(poses))

    def _sockets(self) -> tuple[list[int], list[int]]:
        first, second = (_columns(self.model.parameters, number) for number in self.between)
        return first.tolist(), second.tolist()

    def _expand(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Full vector (..., P + 1) and its derivative (..., P + 1, P)."""
        first, second = self._sockets()
        count = len(self.model.parameters)
        kept = [k for k in range(count) if k not in second]
        nominal = np.array([p.nominal for p in self.model.parameters])
        axes = _frame_along(nominal[second] - nominal[first])
        az, el = x[..., -2], x[..., -1]
        zero = np.zeros_like(az)
        direction, by_az, by_el = (
            self.distance_m * np.stack(parts, axis=-1) @ axes.T
            for parts in (
                (np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)),
                (-np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), zero),
                (-np.sin(el) * np.cos(az), -np.sin(el) * np.sin(az), np.cos(el)),
            )
        )
        full = np.zeros((*x.shape[:-1], count))
        full[..., kept] = x[..., :-2]
        full[..., second] = full[..., first] + direction
        rates = np.zeros((*x.shape[:-1], count, count - 1))
        rates[..., kept, range(len(kept))] = 1.0
        rates[..., second, [kept.index(k) for k in first]] = 1.0
        rates[..., second, -2] = by_az
        rates[..., second, -1] = by_el
        return full, rates


def _columns(parameters: tuple[Parameter, ...], number: int) -> IntArray:
    names = [p.name for p in parameters]
    wanted = [f"{axis}[{number}]" for axis in AXES]
    missing = [name for name in wanted if name not in names]
    if missing:
        raise ValueError(f"placement {number} has no unknown {', '.join(missing)}")
    return np.array([names.index(name) for name in wanted], dtype=np.int64)


def _frame_along(v: FloatArray) -> FloatArray:
    """Axes (3, 3), as columns, of which the first is along `v`."""
    x = v / np.linalg.norm(v)
    side = np.cross(x, np.eye(3)[int(np.argmin(np.abs(x)))])
    y = side / np.linalg.norm(side)
    return np.stack((x, y, np.cross(x, y)), axis=-1)
