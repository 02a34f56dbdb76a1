"""Sessions of thousands of poses with one fault each; the generator is that of `shop_floor`. Judges nothing."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.oracles.shop_floor import Session, Sizes, Specimen, Stream, closed_walk, stream, taken
from tests.oracles.shop_floor_walk import LOWER_DEG, UPPER_DEG

CHUNK = 2000
"""Poses of one walk: a walk of more is not found at once."""


def large(seed: int, poses: int) -> Session:
    """Take a sound session of so many poses."""
    return _walked(Specimen.drawn(seed, Sizes()), poses)


def _walked(specimen: Specimen, poses: int, *, moved: np.ndarray | None = None) -> Session:
    """Walk after walk; what has `moved` on the table did so half-way."""
    parts, half = [], poses // 2
    for walk, first in enumerate(range(0, poses, CHUNK)):
        count = min(CHUNK, poses - first)
        slipped = None
        if moved is not None and first + count > half:
            slipped = (max(half - first, 0), moved, np.zeros(6))
        found = closed_walk(specimen, count, walk=walk, slipped=slipped)
        parts.append(taken(specimen, *found, walk=walk))
    rows = ("readings", "spread", "samples", "angles", "ground", "hand")
    whole = {name: np.concatenate([getattr(p, name) for p in parts]) for name in rows}
    return replace(parts[0], **whole, minute=np.arange(poses))


def slip_of_a_fifth(sound: Session) -> Session:
    """Joint 2 reads a degree too much in a fifth of the poses, here and there."""
    read = sound.readings.copy()
    some = _rng(sound).choice(len(sound), len(sound) // 5, replace=False)
    read[some, 1] += np.deg2rad(1.0)
    return replace(sound, readings=read)


def slip_half_way(sound: Session) -> Session:
    """Joint 2 reads a degree too much in the last half."""
    read = sound.readings.copy()
    read[len(sound) // 2 :, 1] += np.deg2rad(1.0)
    return replace(sound, readings=read)


def odd(sound: Session, share: float) -> Session:
    """In a share of the poses one joint reads half a degree too much or too little."""
    rng, read = _rng(sound), sound.readings.copy()
    some = rng.choice(len(sound), round(share * len(sound)), replace=False)
    size = np.deg2rad(0.5) * rng.choice((-1.0, 1.0), len(some))
    read[some, rng.integers(7, size=len(some))] += size
    return replace(sound, readings=read)


def shaken(sound: Session) -> Session:
    """Every joint of every pose is read while it shakes by 0.15 deg."""
    noise = np.deg2rad(0.15) * _rng(sound).normal(size=sound.readings.shape)
    return replace(sound, readings=sound.readings + noise)


def frozen(sound: Session) -> Session:
    """Joint 4 reads the same from the middle on."""
    half = len(sound) // 2
    read, spread = sound.readings.copy(), sound.spread.copy()
    read[half:, 3], spread[half:, 3] = read[half, 3], 0.0
    return replace(sound, readings=read, spread=spread)


def longer_elbow(sound: Session) -> Session:
    """The forearm is 30 mm longer than the file says."""
    specimen = sound.specimen
    chain = specimen.chain.changed(s_5=specimen.chain.value("s_5") + 0.03)
    return _walked(replace(specimen, chain=chain), len(sound))


def slipped_hinge(sound: Session) -> Session:
    """The hinge shifts by 5 mm on the table half-way."""
    way = _rng(sound).normal(size=3)
    moved = np.concatenate((np.zeros(3), 5e-3 * way / np.linalg.norm(way)))
    return _walked(sound.specimen, len(sound), moved=moved)


def wrong_sign(sound: Session) -> Session:
    """Joint 3 counts the other way round the middle of its range."""
    read = sound.readings.copy()
    read[:, 2] = np.deg2rad(LOWER_DEG + UPPER_DEG)[2] - read[:, 2]
    return replace(sound, readings=read)


def _rng(sound: Session) -> np.random.Generator:
    return stream(sound.specimen.seed, Stream.FAULTS)


LARGE_FAULTS: dict[str, tuple[Callable[[Session], Session], str]] = {
    "sound": (lambda sound: sound, ""),
    "slip of a fifth": (slip_of_a_fifth, "ENCODER_2|OUTLIERS"),
    "slip half-way": (slip_half_way, "STEP_JOINT_2"),
    "1 % odd": (lambda sound: odd(sound, 0.01), "OUTLIERS"),
    "10 % odd": (lambda sound: odd(sound, 0.1), "OUTLIERS"),
    "30 % odd": (lambda sound: odd(sound, 0.3), "OUTLIERS|SCATTER"),
    "shaken": (shaken, "SCATTER"),
    "frozen for half": (frozen, "FROZEN(_JOINT)?_4"),
    "elbow 30 mm": (longer_elbow, "LENGTH_s_[35]"),
    "hinge slips 5 mm": (slipped_hinge, "SLIP_FIXTURE"),
    "sign": (wrong_sign, "SIGN_JOINT_3"),
}
"""A fault, and the codes of which any names it first."""
