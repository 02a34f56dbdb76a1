"""Sessions of thousands of poses, and faults done to them; the generator is that of `shop_floor`. Judges nothing."""

from dataclasses import replace

import numpy as np

from tests.oracles.shop_floor import Session, Sizes, Specimen, Stream, closed_walk, stream, taken

CHUNK = 2000
"""Poses of one walk: a walk of more is not found at once."""


def large(seed: int, poses: int, sizes: Sizes | None = None) -> Session:
    """Take a sound session of so many poses."""
    return _walked(Specimen.drawn(seed, Sizes() if sizes is None else sizes), poses)


def _walked(specimen: Specimen, poses: int) -> Session:
    """Walk after walk."""
    parts = [
        taken(specimen, *closed_walk(specimen, min(CHUNK, poses - first), walk=walk), walk=walk)
        for walk, first in enumerate(range(0, poses, CHUNK))
    ]
    rows = ("readings", "spread", "samples", "angles", "ground", "hand")
    whole = {name: np.concatenate([getattr(p, name) for p in parts]) for name in rows}
    return replace(parts[0], **whole, minute=np.arange(poses))


def slip_of_a_fifth(sound: Session) -> Session:
    """Joint 2 reads a degree too much in a fifth of the poses, here and there."""
    read = sound.readings.copy()
    some = _rng(sound).choice(len(sound), len(sound) // 5, replace=False)
    read[some, 1] += np.deg2rad(1.0)
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


def longer_elbow(sound: Session) -> Session:
    """The forearm is 30 mm longer than the file says."""
    specimen = sound.specimen
    chain = specimen.chain.changed(s_5=specimen.chain.value("s_5") + 0.03)
    return _walked(replace(specimen, chain=chain), len(sound))


def _rng(sound: Session) -> np.random.Generator:
    return stream(sound.specimen.seed, Stream.FAULTS)
