"""Simulated arms with every error of an ordinary workshop, and the pose sets that they produce.

Shares no code with `solver`, `fixtures` or `hardware`. A seed is an arm; each error source has its own random
stream, so that switching one off leaves the others unchanged. `Sizes` has the sizes of the packaged files.

    taken = session(seed, Sizes())              # everything at its stated size
    taken = session(seed, Sizes.only("twists")) # RVDT curves, noise and quantisation are always present
    taken.truth["theta_off_3"], taken.readings, taken.csv()
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from enum import IntEnum
from typing import Any

import numpy as np

from tests.oracles.loop_oracle import COLUMNS
from tests.oracles.shop_floor_chain import (
    BOX_DEG,
    DRIVES,
    FOLLOW,
    LINKS,
    LOWER_DEG,
    STRAY_RAD,
    UPPER_DEG,
    Chain,
    Chart,
    Loop,
    frames,
    in_range,
    nominal_chain,
    nominal_chart,
    wander,
)
from tests.oracles.shop_floor_load import Load
from tests.oracles.shop_floor_sensors import CURVES, Encoder, Rvdt, drawn_curve

START = datetime(2020, 5, 4, 9, tzinfo=UTC)

PARAMETERS = (
    *(f"theta_off_{j}" for j in range(1, 8)),
    *("a_0", "s_0", "alpha_0", "s_1", "a_7", "s_7", "alpha_7"),
)
"""The parameters that the paper calibrates."""

LENGTHS = (*(f"s_{j}" for j in range(2, 7)), *(f"a_{j}" for j in range(1, 7)))
TWISTS = tuple(f"alpha_{j}" for j in range(1, 7))
"""Fixed parameters of the arm file."""

ENTRIES = tuple(f"{column}_{row}" for column in COLUMNS for row in range(LINKS))

ENCODERS = (1, 2, 3, 4, 5)
RVDTS = (6, 7)
COUNTS_PER_REV = 400_000
FULL_SCALE = np.deg2rad(120.0)
BITS = 12
LONGEST_WALK = 2000
"""Poses of a longer walk leave the range."""

SCATTER = 0.3
"""Non-repeatable fraction of the hinge's deflection; the rest is a smooth function of load."""

SOURCES = {
    "lengths": ("length_m",),
    "twists": ("twist_rad",),
    "encoders": ("encoder_rad",),
    "give": ("give_m", "give_rad"),
    "sag": ("sag_rad",),
    "backlash": ("backlash_rad",),
}


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """Standard deviations of the error sources.

    `linearity` limits an RVDT's deviation from its best-fit line, as a fraction of full scale; a specimen has
    half of it to all. `gain` is the standard deviation of the line's slope.
    """

    length_m: float = 0.5e-3
    twist_rad: float = np.deg2rad(0.1)
    encoder_rad: float = np.deg2rad(0.01)
    give_m: float = 0.2e-3
    give_rad: float = 0.2e-3
    sag_rad: float = np.deg2rad(0.01)
    backlash_rad: float = np.deg2rad(0.01)
    linearity: float = 0.02
    noise_lsb: float = 2.0
    gain: float = 0.005

    @classmethod
    def only(cls, *sources: str, times: float = 1.0) -> Sizes:
        """Some of `SOURCES` at `times` their stated size, the others at zero; sensor errors unchanged."""
        stated = cls()
        scale = {n: times * (source in sources) for source in SOURCES for n in SOURCES[source]}
        return replace(stated, **{n: k * getattr(stated, n) for n, k in scale.items()})


Stream = IntEnum(
    "Stream",
    "OFFSETS HINGE LENGTHS TWISTS ENCODERS CURVES LOADS BACKLASH WALK SCATTER NOISE FAULTS",
    start=0,
)


def stream(seed: int, which: Stream, *walk: int) -> np.random.Generator:
    """One random stream of an arm, or of one walk of it."""
    return np.random.default_rng([77_003, seed, int(which), *walk])


@dataclass(frozen=True, kw_only=True)
class Specimen:
    """One arm in one hinge: true chain, loads, sensors 1..7, backlash of joints 1..7.

    `play_by_load` (7,): whether a joint's backlash follows the sign of its load or its direction of approach.
    """

    seed: int
    sizes: Sizes
    chain: Chain
    load: Load
    sensors: tuple[Encoder | Rvdt, ...]
    play_by_load: np.ndarray

    @classmethod
    def drawn(cls, seed: int, sizes: Sizes) -> Specimen:
        """Draw offsets within a few degrees, and a hinge within some mm and degrees, of the files."""
        chain = nominal_chain()
        offsets = np.deg2rad(2.0) * stream(seed, Stream.OFFSETS).normal(size=7)
        changes = {f"theta_off_{j}": o for j, o in enumerate(offsets, 1)}
        rng = stream(seed, Stream.HINGE)
        changes |= {n: 4e-3 * rng.normal() for n in ("a_0", "s_0", "s_1", "a_7", "s_7")}
        changes |= {n: np.deg2rad(1.5) * rng.normal() for n in ("alpha_0", "alpha_7")}
        rng = stream(seed, Stream.LENGTHS)
        changes |= {n: sizes.length_m * rng.normal() for n in LENGTHS}
        rng = stream(seed, Stream.TWISTS)
        changes |= {n: sizes.twist_rad * rng.normal() for n in TWISTS}
        chain = chain.changed(**{n: chain.value(n) + d for n, d in changes.items()})
        return cls(
            seed=seed,
            sizes=sizes,
            chain=chain,
            load=Load.drawn(
                nominal_chain(),
                nominal_chart().angles,
                stream(seed, Stream.LOADS),
                sag_rad=sizes.sag_rad,
                give_rad=sizes.give_rad * np.sqrt(1.0 - SCATTER**2),
                give_m=sizes.give_m * np.sqrt(1.0 - SCATTER**2),
            ),
            sensors=_sensors(seed, sizes),
            play_by_load=stream(seed, Stream.BACKLASH).random(7) < 0.5,
        )


ROWS = ("readings", "spread", "samples", "angles", "ground", "hand", "minute")


@dataclass(frozen=True, kw_only=True)
class Session:
    """Readings of a session, and the truth behind them.

    `angles` (m, 8) are true angles, the hinge's first; `ground` and `hand` (m, 6) deflections; `truth` has every
    D-H entry by name; `minute` (m,) is when each pose was captured.
    """

    readings: np.ndarray
    spread: np.ndarray
    samples: np.ndarray
    angles: np.ndarray
    ground: np.ndarray
    hand: np.ndarray
    minute: np.ndarray
    specimen: Specimen
    truth: dict[str, float] = field(repr=False)

    def __len__(self) -> int:
        return len(self.readings)

    def picked(self, keep) -> Session:
        """Return the session with these poses only, in this order."""
        return replace(self, **{name: getattr(self, name)[keep] for name in ROWS})

    def csv(self) -> str:
        columns = [f"{name}{j}_deg" for name in ("theta", "sd") for j in range(1, 8)]
        lines = [",".join(["placement", "pose", *columns, "samples", "utc"])]
        for row, angles_deg in enumerate(np.rad2deg(np.hstack((self.readings, self.spread)))):
            utc = (START + timedelta(minutes=int(self.minute[row]))).isoformat()
            cells = (*(repr(float(v)) for v in angles_deg), str(int(self.samples[row])), utc)
            lines.append(",".join(("1", f"p{row + 1:03d}", *cells)))
        return "\n".join(lines) + "\n"


def session(
    seed: int,
    sizes: Sizes | None = None,
    *,
    poses: int = 40,
    samples: int = 32,
    box_deg=BOX_DEG,
    walk: int = 0,
) -> Session:
    """Simulate a session of the arm of `seed`; `walk` numbers the sessions of one arm."""
    specimen = Specimen.drawn(seed, Sizes() if sizes is None else sizes)
    return walked(specimen, poses, samples=samples, walk=walk, box_deg=box_deg)


def walked(
    specimen: Specimen, poses: int = 40, *, samples: int = 32, walk: int = 0, **how: Any
) -> Session:
    """Simulate a session of an arm, of several random walks if one would be too long."""
    if poses <= LONGEST_WALK:
        closed = closed_random_walk(specimen, poses, walk=walk, **how)
        return taken(specimen, *closed, samples=samples, walk=walk)
    counts = [min(LONGEST_WALK, poses - first) for first in range(0, poses, LONGEST_WALK)]
    parts = [walked(specimen, n, samples=samples, walk=k, **how) for k, n in enumerate(counts)]
    rows = {name: np.concatenate([getattr(p, name) for p in parts]) for name in ROWS}
    return replace(parts[0], **rows | {"minute": np.arange(poses)})


def closed_random_walk(
    specimen: Specimen,
    poses: int,
    *,
    box_deg=BOX_DEG,
    walk: int = 0,
    chart: Chart | None = None,
    slipped: tuple[int, np.ndarray, np.ndarray] | None = None,
):
    """True angles (poses, 8) of a random walk, and deflections of table and hand, (poses, 6) each.

    `slipped`: the first pose after a slip, and the displacements (6,) of the hinge's two halves.
    """
    chart = nominal_chart() if chart is None else chart
    loop = Loop(chain=specimen.chain)
    rng = stream(specimen.seed, Stream.WALK, walk)
    positions = wander(rng, 4 * poses, box_deg=box_deg)
    guess = chart.near(positions)
    guess[:, list(DRIVES)] = chart.drives + specimen.chain.theta_off[list(DRIVES)] + positions
    rigid, valid = loop.closed(guess, free=FOLLOW, rounds=20)
    valid &= np.abs(rigid - guess).max(axis=-1) < STRAY_RAD
    valid &= in_range((rigid - specimen.chain.theta_off)[:, 1:])
    if valid.sum() < poses:
        raise RuntimeError(
            f"arm {specimen.seed}: {valid.sum()} of {len(valid)} positions are valid"
        )
    rigid = rigid[valid]
    # A displacement of 0.2 mm does not change the load that causes it.
    ground, hand = specimen.load.give(frames(specimen.chain, rigid), rigid)
    scatter = stream(specimen.seed, Stream.SCATTER).normal(size=ground.shape)
    size = np.repeat([specimen.sizes.give_rad, specimen.sizes.give_m], 3)
    ground = ground + SCATTER * size * scatter
    if slipped is not None:
        first_pose, ground_step, hand_step = slipped
        ground[first_pose:] += ground_step
        hand[first_pose:] += hand_step
    angles, closes = loop.closed(rigid, free=FOLLOW, ground=ground, hand=hand)
    rows = np.flatnonzero(closes & (np.abs(angles - rigid).max(axis=-1) < STRAY_RAD))[:poses]
    if len(rows) < poses:
        raise RuntimeError(f"arm {specimen.seed}: {len(rows)} of {poses} loops close")
    return angles[rows], ground[rows], hand[rows]


def taken(
    specimen: Specimen,
    angles: np.ndarray,
    *deflections: np.ndarray,
    samples: int = 32,
    walk: int = 0,
) -> Session:
    """Simulate readings of true angles (m, 8); `deflections` (m, 6) of table and hand, zero in a rigid fixture."""
    ground, hand = deflections or (np.zeros((len(angles), 6)),) * 2
    torque = specimen.load.torque(frames(specimen.chain, angles, ground=ground, hand=hand))
    twist = specimen.load.sag * torque
    previous_angles = np.concatenate((angles[:1], angles[:-1]))
    motion = angles - previous_angles
    play_sign = np.sign(np.where(specimen.play_by_load, torque[:, 1:], motion[:, 1:]))
    at_sensor = (angles - specimen.chain.theta_off - twist)[:, 1:]
    at_sensor = at_sensor - specimen.sizes.backlash_rad * play_sign
    rng = stream(specimen.seed, Stream.NOISE, walk)
    sensors = zip(specimen.sensors, at_sensor.T, strict=True)
    sensor_readings = [sensor.read(angle, samples, rng) for sensor, angle in sensors]
    return Session(
        readings=np.stack([mean for mean, _ in sensor_readings], axis=-1),
        spread=np.stack([spread for _, spread in sensor_readings], axis=-1),
        samples=np.full(len(angles), samples),
        angles=angles,
        ground=ground,
        hand=hand,
        minute=np.arange(len(angles)),
        specimen=specimen,
        truth={name: specimen.chain.value(name) for name in ENTRIES},
    )


def _sensors(seed: int, sizes: Sizes) -> tuple[Encoder | Rvdt, ...]:
    rng = stream(seed, Stream.ENCODERS)
    sensors: list[Encoder | Rvdt] = []
    for _ in ENCODERS:
        once, twice = (tuple(sizes.encoder_rad * rng.normal(size=2)) for _ in range(2))
        sensors.append(Encoder(counts_per_rev=COUNTS_PER_REV, once=once, twice=twice))
    rng = stream(seed, Stream.CURVES)
    for joint in RVDTS:
        errors = {name: getattr(sizes, name) for name in ("linearity", "noise_lsb", "gain")}
        sensors.append(draw_rvdt(joint, rng, **errors))
    return tuple(sensors)


def draw_rvdt(
    joint: int, rng: np.random.Generator, *, linearity: float, noise_lsb: float, gain: float
) -> Rvdt:
    """Draw an RVDT whose deviation from a line of random slope is within `linearity` of full scale."""
    shape = drawn_curve(str(rng.choice(CURVES)), rng)
    size = linearity * FULL_SCALE * rng.uniform(0.5, 1.0)
    return Rvdt(
        bits=BITS,
        full_scale=FULL_SCALE,
        zero=np.deg2rad(0.5 * (LOWER_DEG + UPPER_DEG)[joint - 1]),
        noise_lsb=noise_lsb,
        shape=size * shape,
        gain=gain * rng.normal(),
    )
