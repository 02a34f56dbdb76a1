"""A set of measured poses: readings, their spread, optional endpoint."""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import dataclass

import numpy as np

from solver.arrays import BoolArray, FloatArray, IntArray, frozen, select_poses


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseSet:
    """Measured poses of an arm of n joints, in the order in which they were taken.

    `placement` (m,): number (from 1) of each pose's placement. `label`: name of each pose, unique in its placement.
    `q_rad`: sensor angles as read, rad, continuous and never wrapped, shape (m, n).
    `sd_rad`: standard deviation of the samples at each pose, shape (m, n), rad; None if not recorded.
    `samples`: number of samples averaged at each pose, shape (m,); None if not recorded.
    `endpoint`: measured x, y, z (m), shape (m, 3), or also a rotation vector (rad), (m, 6); None without an instrument.
    `utc`, `notes`: time and operator's note of each pose, "" if a pose has none, length m; None if no pose has one.
    """

    placement: IntArray
    label: tuple[str, ...]
    q_rad: FloatArray
    sd_rad: FloatArray | None = None
    samples: IntArray | None = None
    endpoint: FloatArray | None = None
    utc: tuple[str, ...] | None = None
    notes: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "placement", _whole(self.placement, "placement"))
        object.__setattr__(self, "label", tuple(str(label) for label in self.label))
        for name in ("q_rad", "sd_rad", "endpoint"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, frozen(value))
        if self.samples is not None:
            object.__setattr__(self, "samples", _whole(self.samples, "samples"))
        self._check()

    def _check(self) -> None:
        self._check_shapes()
        for name in ("q_rad", "sd_rad", "endpoint"):
            if (value := getattr(self, name)) is not None and not np.all(np.isfinite(value)):
                raise ValueError(f"{name} must be finite")
        if self.sd_rad is not None and np.any(self.sd_rad < 0.0):
            raise ValueError("sd_rad must not be negative")
        if np.any(self.placement < 1) or (self.samples is not None and np.any(self.samples < 1)):
            raise ValueError("placement and samples must be 1 or more")
        if any(not label or label != label.strip() for label in self.label):
            raise ValueError("every pose needs a name without white space around it")
        if len(set(self.keys)) != len(self):
            (placement, label), _ = Counter(self.keys).most_common(1)[0]
            raise ValueError(
                f"two poses of placement {placement} have the name {label!r}: give each its own"
            )

    def _check_shapes(self) -> None:
        if self.q_rad.ndim != 2 or self.q_rad.shape[1] == 0:
            raise ValueError("q_rad must have one row per pose and one column per joint")
        m = len(self.q_rad)
        for name in ("placement", "label", "sd_rad", "samples", "endpoint", "utc", "notes"):
            if (value := getattr(self, name)) is not None and len(value) != m:
                raise ValueError(f"{name} has length {len(value)}, not {m} (one per pose)")
        if self.placement.ndim != 1 or (self.samples is not None and self.samples.ndim != 1):
            raise ValueError("placement and samples must each have one number per pose")
        if self.sd_rad is not None and self.sd_rad.shape != self.q_rad.shape:
            raise ValueError("sd_rad must have the shape of q_rad")
        if self.endpoint is not None and self.endpoint.shape[1:] not in ((3,), (6,)):
            raise ValueError("endpoint must have 3 or 6 columns")

    def __len__(self) -> int:
        return len(self.q_rad)

    def at_poses(self, poses: IntArray | BoolArray) -> PoseSet:
        """Return a selection of the poses, in the order of `poses`."""
        return select_poses(self, poses, *self.__dataclass_fields__)

    @property
    def sample_counts(self) -> IntArray:
        """Number of readings averaged at each pose (m,); 1 if not recorded."""
        return np.ones(len(self), dtype=np.int64) if self.samples is None else self.samples

    @property
    def joint_count(self) -> int:
        """Number n of joints."""
        return int(self.q_rad.shape[1])

    @property
    def keys(self) -> tuple[tuple[int, str], ...]:
        """Placement and label of every pose."""
        return tuple((int(p), label) for p, label in zip(self.placement, self.label, strict=True))

    @property
    def placements(self) -> tuple[int, ...]:
        """Numbers of the placements, ascending."""
        return tuple(sorted({int(p) for p in self.placement}))

    def sha256(self) -> str:
        """SHA-256 of the data that a calibration uses: keys, angles, spreads, samples, endpoints.

        The digest does not depend on the order of the poses, the format of a file, times or notes. Sets with the same
        digest have bit-for-bit the same numbers (except for the sign of zero).
        """
        digest = hashlib.sha256(b"sarcal/poses/1\n")
        columns = [self.q_rad, self.sd_rad, self.endpoint]
        shape = ",".join("-" if c is None else str(c.shape[1]) for c in columns)
        digest.update(f"{shape};{'-' if self.samples is None else 1}\n".encode())
        keys = self.keys
        for k in sorted(range(len(self)), key=keys.__getitem__):
            placement, label = keys[k]
            name = label.encode("utf-8", "surrogatepass")
            digest.update(f"{placement} {len(name)} ".encode() + name + b"\n")
            for column in columns:
                if column is not None:
                    # Adding zero turns -0.0 into 0.0; little-endian whatever the machine.
                    digest.update((column[k] + 0.0).astype("<f8").tobytes())
            if self.samples is not None:
                digest.update(int(self.samples[k]).to_bytes(8, "little"))
        return digest.hexdigest()


def _whole(values: IntArray, name: str) -> IntArray:
    array = np.array(values)
    if array.size and not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"{name} must be whole numbers")
    array = array.astype(np.int64)
    array.setflags(write=False)
    return array


def canonical_order(q: FloatArray) -> IntArray:
    """Indices that sort poses (m, n) by their first joint, then the second, ..."""
    return np.asarray(np.lexsort(q.T[::-1]), dtype=np.int64)


def back_to_caller(order: IntArray) -> IntArray:
    """Indices that undo `order`: ``values[order][back_to_caller(order)]`` is ``values``."""
    back = np.empty_like(order)
    back[order] = np.arange(len(order))
    return back
