"""Simulated sessions of thousands of poses, and faults applied to them."""

from dataclasses import replace

import numpy as np

from tests.oracles.shop_floor import (
    Session,
    Sizes,
    Specimen,
    Stream,
    closed_random_walk,
    stream,
    taken,
)

CHUNK = 2000
"""Most poses of one walk: longer ones leave the range."""


def large(seed: int, poses: int, sizes: Sizes | None = None) -> Session:
    return _walked(Specimen.drawn(seed, Sizes() if sizes is None else sizes), poses)


def _walked(specimen: Specimen, poses: int) -> Session:
    """Join walks of at most `CHUNK` poses."""
    walks = [
        taken(
            specimen, *closed_random_walk(specimen, min(CHUNK, poses - first), walk=walk), walk=walk
        )
        for walk, first in enumerate(range(0, poses, CHUNK))
    ]
    rows = ("readings", "spread", "samples", "angles", "ground", "hand")
    arrays = {name: np.concatenate([getattr(p, name) for p in walks]) for name in rows}
    return replace(walks[0], **arrays, minute=np.arange(poses))


def step_in_fifth_of_poses(sound: Session) -> Session:
    """Joint 2 reads 1 deg too much in a random fifth of the poses."""
    readings = sound.readings.copy()
    affected = _rng(sound).choice(len(sound), len(sound) // 5, replace=False)
    readings[affected, 1] += np.deg2rad(1.0)
    return replace(sound, readings=readings)


def odd(sound: Session, share: float) -> Session:
    """A random joint is off by 0.5 deg in a fraction of the poses."""
    rng, readings = _rng(sound), sound.readings.copy()
    affected = rng.choice(len(sound), round(share * len(sound)), replace=False)
    size = np.deg2rad(0.5) * rng.choice((-1.0, 1.0), len(affected))
    readings[affected, rng.integers(7, size=len(affected))] += size
    return replace(sound, readings=readings)


def shaken(sound: Session) -> Session:
    """Every reading has 0.15 deg of vibration noise."""
    noise = np.deg2rad(0.15) * _rng(sound).normal(size=sound.readings.shape)
    return replace(sound, readings=sound.readings + noise)


def longer_elbow(sound: Session) -> Session:
    """The forearm is 30 mm longer than in the file."""
    specimen = sound.specimen
    chain = specimen.chain.changed(s_5=specimen.chain.value("s_5") + 0.03)
    return _walked(replace(specimen, chain=chain), len(sound))


def _rng(sound: Session) -> np.random.Generator:
    return stream(sound.specimen.seed, Stream.FAULTS)
