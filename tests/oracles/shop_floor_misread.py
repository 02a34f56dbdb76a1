"""What is read wrongly on a shop floor: sensors that slip, stick, bend and end, and files that hold something else.

The joints stand where they stand, and the fixture holds. Knows the generator; nothing of who judges.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from tests.oracles.shop_floor import (
    BITS,
    FULL_SCALE,
    PARAMETERS,
    RVDTS,
    Session,
    Sizes,
    Specimen,
    Stream,
    closed_walk,
    drawn_rvdt,
    session,
    stream,
    taken,
)
from tests.oracles.shop_floor_sensors import Rvdt
from tests.oracles.shop_floor_walk import LOWER_DEG, UPPER_DEG

COUNT = 2.0 * np.pi / 400_000
LSB = FULL_SCALE / 2**BITS


@dataclass(frozen=True, kw_only=True)
class Case:
    """A session with a fault.

    Attributes
    ----------
    causes
        Patterns (regular expressions, whole code) of which any names the fault.
    judged
        Parameters that have a truth still.
    either
        Another value that is as true, by name: a joint's offset before and after its counts slipped.
    nominal
        What the operator wrote into his arm and fixture files instead of what is shipped, by entry.
    harmless
        Whether the fault is within what the files state: to be survived, not found.
    """

    taken: Session
    causes: tuple[str, ...]
    judged: tuple[str, ...] = PARAMETERS
    either: dict[str, float] = field(default_factory=dict)
    nominal: dict[str, float] = field(default_factory=dict)
    harmless: bool = False


def rippled(seed: int) -> Case:
    """RVDTs whose curves are sines of one period to two over full scale, within their linearity: sound."""
    rng = stream(seed, Stream.FAULTS)
    specimen = Specimen.drawn(seed, Sizes())
    x = np.linspace(-1.0, 1.0, 2001)
    for joint in RVDTS:
        y = np.sin(np.pi * rng.uniform(1.0, 2.0) * x + rng.uniform(0.0, 2.0 * np.pi))
        y -= np.polyval(np.polyfit(x, y, 1), x)
        size = rng.uniform(0.8, 1.0) * specimen.sizes.linearity * FULL_SCALE / np.abs(y).max()
        sensor = specimen.sensors[joint - 1]
        assert isinstance(sensor, Rvdt)
        specimen = _with_sensor(specimen, joint, replace(sensor, shape=size * y))
    return Case(taken=taken(specimen, *closed_walk(specimen, 40)), causes=())


def slipped_joint(
    seed: int,
    *,
    deg: float = 0.0,
    counts: int = 0,
    harmless: bool = False,
    only: tuple[int, ...] = (),
) -> Case:
    """One joint's sensor loses counts in mid-session."""
    rng = stream(seed, Stream.FAULTS)
    joint = int(rng.choice(only or range(1, 8)))
    size = np.deg2rad(deg) + counts * (LSB if joint in RVDTS else COUNT)
    size *= rng.choice((-1.0, 1.0))
    found = session(seed)
    read = found.readings.copy()
    read[int(rng.integers(8, 33)) :, joint - 1] += size
    name = f"theta_off_{joint}"
    return Case(
        taken=replace(found, readings=read),
        causes=(f"STEP_JOINT_{joint}",),
        either={name: found.truth[name] - size},
        harmless=harmless,
    )


def frozen(seed: int) -> Case:
    """One joint's reading stays where it is from the middle of the session on."""
    rng = stream(seed, Stream.FAULTS)
    joint = int(rng.integers(1, 8))
    found = session(seed)
    read, spread = found.readings.copy(), found.spread.copy()
    read[20:, joint - 1] = read[20, joint - 1]
    spread[20:, joint - 1] = 0.0
    return Case(
        taken=replace(found, readings=read, spread=spread),
        causes=(f"FROZEN_{joint}", f"FROZEN_JOINT_{joint}"),
    )


def odd_poses(seed: int, *, poses: int) -> Case:
    """In some poses one joint reads half a degree too much or too little."""
    rng = stream(seed, Stream.FAULTS)
    found = session(seed)
    read = found.readings.copy()
    for k in rng.choice(40, poses, replace=False):
        read[k, rng.integers(7)] += np.deg2rad(0.5) * rng.choice((-1.0, 1.0))
    return Case(taken=replace(found, readings=read), causes=("OUTLIER.*",))


def bent_rvdt(seed: int, *, percent: float) -> Case:
    """An RVDT that strays by `percent` of full scale from its best line over the motion."""
    rng = stream(seed, Stream.FAULTS)
    joint = int(rng.choice(RVDTS))
    sound_one = session(seed)
    bent = drawn_rvdt(joint, rng, linearity=0.02, noise_lsb=2.0, gain=0.0)
    angle = (sound_one.angles - sound_one.specimen.chain.theta_off)[:, joint]
    off = bent.deviation(angle)
    stray = np.abs(off - np.polyval(np.polyfit(angle, off, 1), angle)).max()
    size = 0.01 * percent * FULL_SCALE / stray
    bent = replace(bent, shape=size * bent.shape)
    specimen = _with_sensor(sound_one.specimen, joint, bent)
    found = taken(specimen, sound_one.angles, sound_one.ground, sound_one.hand)
    # What strays so far may end at full scale in some poses, and that is true of it as well.
    middle = np.deg2rad(0.5 * (LOWER_DEG + UPPER_DEG)[joint - 1])
    at_end = np.abs(found.readings[:, joint - 1] - middle) > 0.5 * FULL_SCALE - 2.0 * LSB
    pinned = (f"SATURATED_{joint}",) if at_end.any() else ()
    return Case(taken=found, causes=(f"RVDT_{joint}", *pinned))


def stuck_rvdt(seed: int) -> Case:
    """An RVDT that reads one and the same angle, with its noise."""
    rng = stream(seed, Stream.FAULTS)
    joint = int(rng.choice(RVDTS))
    found = session(seed)
    read = found.readings.copy()
    still = read[0, joint - 1] + LSB * 2.0 / np.sqrt(32.0) * rng.normal(size=40)
    read[:, joint - 1] = still
    return Case(
        taken=replace(found, readings=read),
        causes=(f"RVDT_{joint}", f"FROZEN_{joint}", f"FROZEN_JOINT_{joint}"),
    )


def saturated_rvdt(seed: int) -> Case:
    """An RVDT mounted so that a fifth of the poses lie beyond the end of its full scale."""
    rng = stream(seed, Stream.FAULTS)
    joint = int(rng.choice(RVDTS))
    found = session(seed)
    angle = (found.angles - found.specimen.chain.theta_off)[:, joint]
    if rng.random() < 0.5:
        shift = np.deg2rad(UPPER_DEG[joint - 1]) - np.quantile(angle, 0.8)
    else:
        shift = np.deg2rad(LOWER_DEG[joint - 1]) - np.quantile(angle, 0.2)
    name = f"theta_off_{joint}"
    chain = found.specimen.chain
    specimen = replace(found.specimen, chain=chain.changed(**{name: chain.value(name) - shift}))
    again = taken(specimen, found.angles, found.ground, found.hand)
    return Case(taken=again, causes=(f"RVDT_{joint}", f"RANGE_{joint}", "RANGE", "SATURATED.*"))


def radians(seed: int) -> Case:
    """The file holds radians."""
    found = session(seed)
    return Case(
        taken=replace(found, readings=np.deg2rad(found.readings), spread=np.deg2rad(found.spread)),
        causes=("RADIANS.*",),
    )


def exchanged(seed: int) -> Case:
    """Two neighbouring columns are exchanged."""
    rng = stream(seed, Stream.FAULTS)
    j = int(rng.integers(1, 7))
    order = list(range(7))
    order[j - 1], order[j] = order[j], order[j - 1]
    found = session(seed)
    return Case(
        taken=replace(found, readings=found.readings[:, order], spread=found.spread[:, order]),
        causes=("EXCHANGED.*", f"RANGE_{j}", f"RANGE_{j + 1}", "RANGE"),
    )


def wrong_sign(seed: int) -> Case:
    """One joint counts the other way round the middle of its range."""
    rng = stream(seed, Stream.FAULTS)
    joint = int(rng.integers(1, 8))
    found = session(seed)
    read = found.readings.copy()
    middle = np.deg2rad(LOWER_DEG + UPPER_DEG)[joint - 1]
    read[:, joint - 1] = middle - read[:, joint - 1]
    name = f"theta_off_{joint}"
    return Case(
        taken=replace(found, readings=read),
        causes=(f"SIGN_{joint}", f"SIGN_JOINT_{joint}"),
        judged=tuple(n for n in PARAMETERS if n != name),
    )


def _with_sensor(specimen: Specimen, joint: int, sensor: Rvdt) -> Specimen:
    sensors = list(specimen.sensors)
    sensors[joint - 1] = sensor
    return replace(specimen, sensors=tuple(sensors))


def hysteresis(found, joint, deg):
    """A sensor that reads so much more on the way up, and less on the way down."""
    read = found.readings.copy()
    moved = np.diff(np.concatenate((read[:1, joint - 1], read[:, joint - 1])))
    read[:, joint - 1] += np.deg2rad(deg) * np.where(moved < 0.0, -1.0, 1.0)
    return replace(found, readings=read)
