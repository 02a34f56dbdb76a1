"""Simulated sessions with one fault each, and the correct diagnoses of it; all other errors at their stated size."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np

from tests.oracles.shop_floor import (
    LENGTHS,
    ROWS,
    Sizes,
    Specimen,
    Stream,
    session,
    stream,
    taken,
    walked,
)
from tests.oracles.shop_floor_chain import (
    LOWER_DEG,
    UPPER_DEG,
    Chain,
    Loop,
    in_range,
    nominal_chain,
)
from tests.oracles.shop_floor_load import Load
from tests.oracles.shop_floor_misread import (
    Case,
    exchanged,
    frozen,
    nonlinear_rvdt,
    odd_poses,
    radians,
    saturated_rvdt,
    slipped_joint,
    stuck_rvdt,
    wrong_sign,
)
from tests.oracles.shop_floor_parallel import parallel_mount

OWN = tuple(f"theta_off_{j}" for j in range(2, 7))
"""Offsets that do not depend on the placement of the hinge."""


def sound(seed: int) -> Case:
    """Only the stated errors."""
    return Case(taken=session(seed), causes=())


def too_few_poses(seed: int, *, poses: int) -> Case:
    """Too few poses for any degrees of freedom."""
    return Case(taken=session(seed, poses=poses), causes=("TOO_FEW_POSES",))


def little_motion(seed: int, *, motion_deg: float) -> Case:
    """Drives that move within `motion_deg`."""
    rng = stream(seed, Stream.FAULTS)
    middle = rng.uniform((-25.0, -65.0), (43.0, -5.0))
    box = tuple((m - 0.5 * motion_deg, m + 0.5 * motion_deg) for m in middle)
    return Case(taken=session(seed, box_deg=box), causes=("LITTLE_MOTION", "UNIDENTIFIABLE"))


def slipped_hinge(seed: int, *, shift_m: float = 0.0, turn_deg: float = 0.0) -> Case:
    """One half of the hinge slips on its base in mid-session."""
    rng = stream(seed, Stream.FAULTS)
    direction = rng.normal(size=6)
    turn, shift = (w / np.linalg.norm(w) for w in (direction[:3], direction[3:]))
    step = np.concatenate((np.deg2rad(turn_deg) * turn, shift_m * shift))
    halves = [step, np.zeros(6)] if rng.random() < 0.5 else [np.zeros(6), step]
    specimen = Specimen.drawn(seed, Sizes())
    slipped = walked(specimen, slipped=(int(rng.integers(8, 33)), *halves))
    return Case(taken=slipped, causes=("SLIP_FIXTURE",), judged=OWN)


def slipped_link(seed: int, *, mm: float) -> Case:
    """The upper arm or the forearm becomes longer or shorter in mid-session, as if its clamp slipped."""
    rng = stream(seed, Stream.FAULTS)
    before, entry = Specimen.drawn(seed, Sizes()), str(rng.choice(("s_3", "s_5")))
    change = 1e-3 * mm * rng.choice((-1.0, 1.0))
    chain = before.chain.changed(**{entry: before.chain.value(entry) + change})
    first, then = walked(before), walked(replace(before, chain=chain))
    k = int(rng.integers(8, 33))
    rows = {n: np.concatenate((getattr(first, n)[:k], getattr(then, n)[k:])) for n in ROWS}
    return Case(taken=replace(first, **rows), causes=("STEP_LENGTH_s_[35]",), judged=OWN)


@cache
def _flipped_pool() -> np.ndarray:
    """Flipped poses (k, 8) of the nominal loop within range, from random starts."""
    rng = np.random.default_rng(4)
    chain = nominal_chain()
    low, high = np.deg2rad(LOWER_DEG), np.deg2rad(UPPER_DEG)
    poses = []
    for _ in range(4):
        angles = np.zeros((1000, 8))
        angles[:, 0] = rng.uniform(-np.pi, np.pi, len(angles))
        angles[:, 1:] = rng.uniform(low, high, (len(angles), 7)) + chain.theta_off[1:]
        poses.append(_closed_flipped(chain, angles))
    return np.concatenate(poses)


def flipped_poses(chain: Chain, rng: np.random.Generator, count: int) -> np.ndarray:
    """Flipped closed angles (count, 8) of a chain near the nominal one, or fewer."""
    pool, poses = _flipped_pool(), np.zeros((0, 8))
    for attempt in range(60):
        start = pool[rng.integers(len(pool), size=100)]
        start = start + np.deg2rad(12.0 + attempt) * rng.normal(size=start.shape)
        poses = np.concatenate((poses, _closed_flipped(chain, start)))
        if len(poses) >= count:
            return poses[:count]
    return poses


def _closed_flipped(chain: Chain, angles: np.ndarray) -> np.ndarray:
    """Angles that closed and whose readings are in range, modulo full turns."""
    angles, closes = Loop(chain=chain, upside_down=True).closed(
        angles, free=tuple(range(8)), rounds=40
    )
    middle = np.deg2rad(0.5 * (LOWER_DEG + UPPER_DEG)) + chain.theta_off[1:]
    angles[:, 1:] = middle + np.mod(angles[:, 1:] - middle + np.pi, 2.0 * np.pi) - np.pi
    return angles[closes & in_range((angles - chain.theta_off)[:, 1:])]


def flipped(seed: int, *, poses: int) -> Case:
    """The hand is upside down on the hinge in some poses, of an arm that can reach such poses."""
    rng, sound_session = stream(seed, Stream.FAULTS), session(seed)
    flipped_angles = flipped_poses(sound_session.specimen.chain, rng, poses)
    if len(flipped_angles) < poses:
        return flipped(seed + 100_000, poses=poses)
    flipped_session = taken(sound_session.specimen, flipped_angles, walk=1)
    order = np.arange(40)
    for k in sorted(rng.choice(40 - poses, poses, replace=False)):
        order = np.insert(order[:-1], k, -1)
    rows = {}
    for name in ("readings", "spread", "angles"):
        rows[name] = getattr(sound_session, name)[order]
        rows[name][order < 0] = getattr(flipped_session, name)
    return Case(taken=replace(sound_session, **rows), causes=("FLIPPED.*",))


def longer_elbow(seed: int, *, mm: float, harmless: bool = False) -> Case:
    """An upper arm or a forearm that is longer or shorter than in the file.

    A loop has no scale: only the ratio of the two lengths can be observed, so either name is a correct diagnosis.
    Both are stated to 0.5 mm: 2 mm are 2.8 standard deviations.
    """
    rng = stream(seed, Stream.FAULTS)
    entry = str(rng.choice(("s_3", "s_5")))
    specimen = Specimen.drawn(seed, Sizes())
    change = 1e-3 * mm * rng.choice((-1.0, 1.0))
    chain = specimen.chain.changed(**{entry: specimen.chain.value(entry) + change})
    specimen = replace(specimen, chain=chain)
    causes = ("LENGTH_s_3", "LENGTH_s_5")
    return Case(taken=walked(specimen), causes=causes, harmless=harmless)


def ball_instead_of_hinge(seed: int) -> Case:
    """The fixture is a ball joint: three equations a pose hold, instead of five."""
    rng = stream(seed, Stream.FAULTS)
    sound_session = session(seed)
    specimen, chain = sound_session.specimen, sound_session.specimen.chain
    angles = np.repeat(sound_session.angles, 4, axis=0)
    angles[:, 1:] += np.deg2rad(8.0) * rng.normal(size=(len(angles), 7))
    loop = Loop(chain=chain, rows=(3, 4, 5))
    angles, closes = loop.closed(angles, free=tuple(range(1, 8)))
    closes &= in_range((angles - chain.theta_off)[:, 1:])
    return Case(taken=taken(specimen, angles[closes][:40]), causes=("WRONG_FIXTURE.*",))


def near_parallel(seed: int, *, joint: int, deg: float) -> Case:
    """The hinge's axis is nearly parallel to that of joint 1 or 7, as in the files."""
    rng = stream(seed, Stream.FAULTS)
    chain, chart = parallel_mount(joint, deg)
    base = Specimen.drawn(seed, Sizes())
    entries = (
        "a_0", "s_0", "s_1", "a_7", "s_7", "alpha_0", "alpha_7", "theta_off_1", "theta_off_7",
    )  # fmt: skip
    changes = {n: chain.value(n) for n in entries}
    changes |= {n: base.chain.value(n) for n in OWN}
    load = Load.drawn(
        chain,
        chart.angles,
        stream(seed, Stream.LOADS),
        sag_rad=base.sizes.sag_rad,
        give_rad=base.sizes.give_rad,
        give_m=base.sizes.give_m,
    )
    specimen = replace(base, chain=base.chain.changed(**changes), load=load)
    box = tuple((np.rad2deg(c.min()), np.rad2deg(c.max())) for c in chart.place.T)
    near = walked(specimen, chart=chart, box_deg=box)
    nominal = {}
    for name in entries:
        angle = name.startswith(("alpha", "theta"))
        size = np.deg2rad(0.1 * min(deg, 5.0) if name.startswith("alpha") else 1.0)
        nominal[name] = chain.value(name) + (size if angle else 3e-3) * rng.normal()
    return Case(taken=near, causes=("PARALLEL.*",), nominal=nominal)


def as_reported(seed: int) -> Case:
    """The paper's three sources: RVDTs of 1.9 %, lengths off by 1 to 2 mm, a compliant hinge."""
    rng = stream(seed, Stream.FAULTS)
    sizes = replace(Sizes.only(), give_m=1e-3, give_rad=2e-3, linearity=0.019)
    specimen = Specimen.drawn(seed, sizes)
    lengths = {
        n: specimen.chain.value(n) + rng.uniform(1e-3, 2e-3) * rng.choice((-1.0, 1.0))
        for n in LENGTHS
    }
    specimen = replace(specimen, chain=specimen.chain.changed(**lengths))
    return Case(
        taken=walked(specimen),
        causes=("LENGTH.*", "GIVE.*", "FIXTURE_GIVES.*", "TOLERANCE.*", "DISCREPANCY.*"),
    )


CASES: dict[str, Callable[[int], Case]] = {
    "3 poses": partial(too_few_poses, poses=3),
    "motion 1 deg": partial(little_motion, motion_deg=1.0),
    "motion 5 deg": partial(little_motion, motion_deg=5.0),
    "hinge slips 1 mm": partial(slipped_hinge, shift_m=1e-3),
    "hinge slips 5 mm": partial(slipped_hinge, shift_m=5e-3),
    "hinge turns 0.5 deg": partial(slipped_hinge, turn_deg=0.5),
    "link slips 2 mm": partial(slipped_link, mm=2.0),
    "1 outlier 0.5 deg": partial(odd_poses, poses=1),
    "3 outliers 0.5 deg": partial(odd_poses, poses=3),
    "3 flipped": partial(flipped, poses=3),
    "12 flipped": partial(flipped, poses=12),
    "RVDT 3 %": partial(nonlinear_rvdt, percent=3.0),
    "RVDT 5 %": partial(nonlinear_rvdt, percent=5.0),
    "RVDT stuck": stuck_rvdt,
    "RVDT saturated": saturated_rvdt,
    "joint slips 0.05 deg": partial(slipped_joint, deg=0.05, only=(1, 2, 3, 4, 5)),
    "joint slips 1 deg": partial(slipped_joint, deg=1.0),
    "joint slips 5 counts": partial(slipped_joint, counts=5, harmless=True),
    "joint slips 50 counts": partial(slipped_joint, counts=50),
    "encoder slips 500 counts": partial(slipped_joint, counts=500, only=(1, 2, 3, 4, 5)),
    "RVDT slips 0.05 deg": partial(slipped_joint, deg=0.05, only=(6, 7), harmless=True),
    "frozen for half": frozen,
    **{
        f"hinge {deg:g} deg from joint {joint}": partial(near_parallel, joint=joint, deg=deg)
        for joint in (1, 7)
        for deg in (5.0, 1.0, 0.5)
    },
    "radians": radians,
    "columns exchanged": exchanged,
    "a joint's sign": wrong_sign,
    "elbow 30 mm": partial(longer_elbow, mm=30.0),
    "elbow 5 mm": partial(longer_elbow, mm=5.0),
    "elbow 2 mm": partial(longer_elbow, mm=2.0, harmless=True),
    "ball for hinge": ball_instead_of_hinge,
    "as_reported": as_reported,
}
"""Cases by name."""
