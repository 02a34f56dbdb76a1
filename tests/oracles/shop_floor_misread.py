"""Simulated sessions with wrong readings: faults of sensors, and mistakes in poses files."""

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
    draw_rvdt,
    session,
    stream,
    taken,
    walked,
)
from tests.oracles.shop_floor_chain import LOWER_DEG, UPPER_DEG
from tests.oracles.shop_floor_sensors import Rvdt

COUNT = 2.0 * np.pi / 400_000
LSB = FULL_SCALE / 2**BITS


@dataclass(frozen=True, kw_only=True)
class Case:
    """A session with a fault.

    `causes`: regular expressions of finding codes, any of which is a correct diagnosis. `judged`: parameters with a
    defined true value. `either`: second true values by name, of a joint's offset after a step of its counts. `nominal`:
    entries of the operator's arm and fixture files that differ from the packaged ones. `harmless`: whether the fault is
    within the stated errors, and need not be diagnosed.
    """

    taken: Session
    causes: tuple[str, ...]
    judged: tuple[str, ...] = PARAMETERS
    either: dict[str, float] = field(default_factory=dict)
    nominal: dict[str, float] = field(default_factory=dict)
    harmless: bool = False


def _sound(seed: int) -> tuple[np.random.Generator, Session, np.ndarray]:
    """Random stream of the faults, a sound session, and a copy of its readings."""
    sound = session(seed)
    return stream(seed, Stream.FAULTS), sound, sound.readings.copy()


def sinusoidal_rvdts(seed: int) -> Case:
    """Sound RVDTs whose deviations are sines of one to two periods over full scale, within their linearity."""
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
    return Case(taken=walked(specimen), causes=())


def slipped_joint(
    seed: int,
    *,
    deg: float = 0.0,
    counts: int = 0,
    harmless: bool = False,
    only: tuple[int, ...] = (),
) -> Case:
    """One joint's reading has a step in mid-session."""
    rng, sound, readings = _sound(seed)
    joint = int(rng.choice(only or range(1, 8)))
    size = np.deg2rad(deg) + counts * (LSB if joint in RVDTS else COUNT)
    size *= rng.choice((-1.0, 1.0))
    readings[int(rng.integers(8, 33)) :, joint - 1] += size
    name = f"theta_off_{joint}"
    return Case(
        taken=replace(sound, readings=readings),
        causes=(f"STEP_JOINT_{joint}",),
        either={name: sound.truth[name] - size},
        harmless=harmless,
    )


def frozen(seed: int) -> Case:
    """One joint's reading is constant from the middle of the session on."""
    rng, sound, readings = _sound(seed)
    joint = int(rng.integers(1, 8))
    spread = sound.spread.copy()
    readings[20:, joint - 1] = readings[20, joint - 1]
    spread[20:, joint - 1] = 0.0
    return Case(
        taken=replace(sound, readings=readings, spread=spread),
        causes=(f"FROZEN_{joint}", f"FROZEN_JOINT_{joint}"),
    )


def odd_poses(seed: int, *, poses: int) -> Case:
    """A random joint is off by 0.5 deg in some poses."""
    rng, sound, readings = _sound(seed)
    for k in rng.choice(40, poses, replace=False):
        readings[k, rng.integers(7)] += np.deg2rad(0.5) * rng.choice((-1.0, 1.0))
    return Case(taken=replace(sound, readings=readings), causes=("OUTLIER.*",))


def nonlinear_rvdt(seed: int, *, percent: float) -> Case:
    """An RVDT with a linearity deviation of `percent` of full scale over the motion."""
    rng, sound, _ = _sound(seed)
    joint = int(rng.choice(RVDTS))
    bent = draw_rvdt(joint, rng, linearity=0.02, noise_lsb=2.0, gain=0.0)
    angle = (sound.angles - sound.specimen.chain.theta_off)[:, joint]
    deviation = bent.deviation(angle)
    peak = np.abs(deviation - np.polyval(np.polyfit(angle, deviation, 1), angle)).max()
    bent = replace(bent, shape=0.01 * percent * FULL_SCALE / peak * bent.shape)
    specimen = _with_sensor(sound.specimen, joint, bent)
    faulty = taken(specimen, sound.angles, sound.ground, sound.hand)
    # A deviation of this size may saturate in some poses, which is then a correct diagnosis as well.
    middle = np.deg2rad(0.5 * (LOWER_DEG + UPPER_DEG)[joint - 1])
    at_end = np.abs(faulty.readings[:, joint - 1] - middle) > 0.5 * FULL_SCALE - 2.0 * LSB
    saturated = (f"SATURATED_{joint}",) if at_end.any() else ()
    return Case(taken=faulty, causes=(f"RVDT_{joint}", *saturated))


def stuck_rvdt(seed: int) -> Case:
    """An RVDT that reads a constant angle, with its noise."""
    rng, sound, readings = _sound(seed)
    joint = int(rng.choice(RVDTS))
    noise = LSB * 2.0 / np.sqrt(32.0) * rng.normal(size=40)
    readings[:, joint - 1] = readings[0, joint - 1] + noise
    return Case(
        taken=replace(sound, readings=readings),
        causes=(f"RVDT_{joint}", f"FROZEN_{joint}", f"FROZEN_JOINT_{joint}"),
    )


def saturated_rvdt(seed: int) -> Case:
    """An RVDT mounted so that a fifth of the poses are beyond its full scale."""
    rng, sound, _ = _sound(seed)
    joint = int(rng.choice(RVDTS))
    chain = sound.specimen.chain
    angle = (sound.angles - chain.theta_off)[:, joint]
    end_deg, quantile = (UPPER_DEG, 0.8) if rng.random() < 0.5 else (LOWER_DEG, 0.2)
    shift = np.deg2rad(end_deg[joint - 1]) - np.quantile(angle, quantile)
    name = f"theta_off_{joint}"
    specimen = replace(sound.specimen, chain=chain.changed(**{name: chain.value(name) - shift}))
    return Case(
        taken=taken(specimen, sound.angles, sound.ground, sound.hand),
        causes=(f"RVDT_{joint}", f"RANGE_{joint}", "RANGE", "SATURATED.*"),
    )


def radians(seed: int) -> Case:
    """The poses file is in radians."""
    sound = session(seed)
    return Case(
        taken=replace(sound, readings=np.deg2rad(sound.readings), spread=np.deg2rad(sound.spread)),
        causes=("RADIANS.*",),
    )


def exchanged(seed: int) -> Case:
    """Two neighbouring columns are exchanged."""
    rng, sound, _ = _sound(seed)
    j = int(rng.integers(1, 7))
    order = list(range(7))
    order[j - 1], order[j] = order[j], order[j - 1]
    return Case(
        taken=replace(sound, readings=sound.readings[:, order], spread=sound.spread[:, order]),
        causes=("EXCHANGED.*", f"RANGE_{j}", f"RANGE_{j + 1}", "RANGE"),
    )


def wrong_sign(seed: int) -> Case:
    """One joint counts in the opposite direction, about the middle of its range."""
    rng, sound, readings = _sound(seed)
    joint = int(rng.integers(1, 8))
    twice_middle = np.deg2rad(LOWER_DEG + UPPER_DEG)[joint - 1]
    readings[:, joint - 1] = twice_middle - readings[:, joint - 1]
    return Case(
        taken=replace(sound, readings=readings),
        causes=(f"SIGN_{joint}", f"SIGN_JOINT_{joint}"),
        judged=tuple(n for n in PARAMETERS if n != f"theta_off_{joint}"),
    )


def _with_sensor(specimen: Specimen, joint: int, sensor: Rvdt) -> Specimen:
    sensors = list(specimen.sensors)
    sensors[joint - 1] = sensor
    return replace(specimen, sensors=tuple(sensors))


def hysteresis(sound: Session, joint: int, deg: float) -> Session:
    """One joint's reading is off by +deg after an upward move, and -deg after a downward one."""
    readings = sound.readings.copy()
    change = np.diff(readings[:, joint - 1], prepend=readings[0, joint - 1])
    readings[:, joint - 1] += np.deg2rad(deg) * np.where(change < 0.0, -1.0, 1.0)
    return replace(sound, readings=readings)
