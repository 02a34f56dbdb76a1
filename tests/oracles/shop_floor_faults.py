"""Everything that goes wrong on a shop floor, done to sessions that were sound: one case, one fault.

A case says which causes would be a true statement about it, and of which parameters a truth is left.
Knows the generator; nothing of who judges. Beside the fault every error is there at its stated size.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tests.oracles.shop_floor import (
    PARAMETERS,
    Sizes,
    Specimen,
    Stream,
    closed_walk,
    session,
    stream,
    taken,
    truth_of,
)
from tests.oracles.shop_floor_chain import Loop
from tests.oracles.shop_floor_flip import flipped_poses
from tests.oracles.shop_floor_load import Load
from tests.oracles.shop_floor_misread import (
    Case,
    bent_rvdt,
    exchanged,
    frozen,
    odd_poses,
    radians,
    saturated_rvdt,
    slipped_joint,
    stuck_rvdt,
    wrong_sign,
)
from tests.oracles.shop_floor_parallel import parallel_mount
from tests.oracles.shop_floor_walk import in_range

OWN = tuple(f"theta_off_{j}" for j in range(2, 7))
"""Offsets that do not depend on where the hinge is."""


def sound(seed: int) -> Case:
    """Nothing is wrong but what the files state."""
    return Case(taken=session(seed), causes=())


def few_poses(seed: int, *, poses: int) -> Case:
    """So few poses that the errors have no degrees of freedom to show in."""
    return Case(taken=session(seed, poses=poses), causes=("TOO_FEW_POSES",))


def little_motion(seed: int, *, motion_deg: float) -> Case:
    """Drives that move by `motion_deg` in all."""
    rng = stream(seed, Stream.FAULTS)
    middle = rng.uniform((-25.0, -65.0), (43.0, -5.0))
    box = tuple((m - 0.5 * motion_deg, m + 0.5 * motion_deg) for m in middle)
    return Case(taken=session(seed, box_deg=box), causes=("LITTLE_MOTION", "UNIDENTIFIABLE"))


def slipped_hinge(seed: int, *, shift_m: float = 0.0, turn_deg: float = 0.0) -> Case:
    """One half of the hinge moves on its base in mid-session."""
    rng = stream(seed, Stream.FAULTS)
    way = rng.normal(size=6)
    turn, shift = (w / np.linalg.norm(w) for w in (way[:3], way[3:]))
    moved = np.concatenate((np.deg2rad(turn_deg) * turn, shift_m * shift))
    halves = [moved, np.zeros(6)] if rng.random() < 0.5 else [np.zeros(6), moved]
    specimen = Specimen.drawn(seed, Sizes())
    slipped = (int(rng.integers(8, 33)), *halves)
    walk = closed_walk(specimen, 40, slipped=slipped)
    return Case(taken=taken(specimen, *walk), causes=("SLIP_FIXTURE",), judged=OWN)


def flipped(seed: int, *, poses: int) -> Case:
    """Some poses have the hand upside down on the hinge; of arms that can reach such poses."""
    rng = stream(seed, Stream.FAULTS)
    found = session(seed)
    over = flipped_poses(found.specimen.chain, rng, poses)
    if len(over) < poses:
        return flipped(seed + 100_000, poses=poses)
    zero = np.zeros((poses, 6))
    theirs = taken(found.specimen, over, zero, zero, walk=1)
    order = np.arange(40)
    for k in sorted(rng.choice(40 - poses, poses, replace=False)):
        order = np.insert(order[:-1], k, -1)
    read, spread, angles = (np.array(getattr(found, n)) for n in ("readings", "spread", "angles"))
    there = order < 0
    for mine, its in ((read, theirs.readings), (spread, theirs.spread), (angles, theirs.angles)):
        mine[~there] = mine[order[~there]]
        mine[there] = its
    return Case(
        taken=replace(found, readings=read, spread=spread, angles=angles), causes=("FLIPPED.*",)
    )


def longer_elbow(seed: int, *, mm: float, harmless: bool = False) -> Case:
    """An upper arm or a forearm that is longer or shorter than the file says.

    A loop has no scale of its own: that one is longer is that the other is shorter, hinge and all, so
    either is a true statement. Their ratio is stated to 0.5 mm each: 2 mm are 2.8 standard deviations.
    """
    rng = stream(seed, Stream.FAULTS)
    entry = str(rng.choice(("s_3", "s_5")))
    specimen = Specimen.drawn(seed, Sizes())
    by = 1e-3 * mm * rng.choice((-1.0, 1.0))
    chain = specimen.chain.changed(**{entry: specimen.chain.value(entry) + by})
    specimen = replace(specimen, chain=chain)
    return Case(
        taken=taken(specimen, *closed_walk(specimen, 40)),
        causes=("LENGTH_s_3", "LENGTH_s_5"),
        harmless=harmless,
    )


def ball_for_hinge(seed: int) -> Case:
    """The hand stands on a ball: three equations a pose hold, five are believed to."""
    rng = stream(seed, Stream.FAULTS)
    found = session(seed)
    chain = found.specimen.chain
    angles = np.repeat(found.angles, 4, axis=0)
    angles[:, 1:] += np.deg2rad(8.0) * rng.normal(size=(len(angles), 7))
    loop = Loop(chain=chain, rows=(3, 4, 5))
    angles, good = loop.closed(angles, free=tuple(range(1, 8)))
    good &= in_range((angles - chain.theta_off)[:, 1:])
    angles = angles[good][:40]
    zero = np.zeros((len(angles), 6))
    return Case(taken=taken(found.specimen, angles, zero, zero), causes=("WRONG_FIXTURE.*",))


def near_parallel(seed: int, *, joint: int, deg: float) -> Case:
    """The hinge's axis nearly parallel to that of joint 1 or 7, and the files say so."""
    rng = stream(seed, Stream.FAULTS)
    chain, chart = parallel_mount(joint, deg)
    base = Specimen.drawn(seed, Sizes())
    entries = (
        "a_0",
        "s_0",
        "s_1",
        "a_7",
        "s_7",
        "alpha_0",
        "alpha_7",
        "theta_off_1",
        "theta_off_7",
    )
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
    walk = closed_walk(specimen, 40, chart=chart, box_deg=box)
    nominal = {}
    for name in entries:
        angle = name.startswith(("alpha", "theta"))
        size = np.deg2rad(0.1 * min(deg, 5.0) if name.startswith("alpha") else 1.0)
        nominal[name] = chain.value(name) + (size if angle else 3e-3) * rng.normal()
    return Case(taken=taken(specimen, *walk), causes=("PARALLEL.*",), nominal=nominal)


def as_reported(seed: int) -> Case:
    """The paper's three sources: RVDTs of 1.9 %, lengths off by 1 to 2 mm, a slender hinge."""
    rng = stream(seed, Stream.FAULTS)
    sizes = replace(Sizes.only(), give_m=1e-3, give_rad=2e-3, linearity=0.019)
    specimen = Specimen.drawn(seed, sizes)
    held = [n for n in truth_of(specimen.chain) if n not in PARAMETERS and n[0] in "sa"]
    held = [n for n in held if not n.startswith("alpha") and n != "a_0"]
    off = {
        n: specimen.chain.value(n) + rng.uniform(1e-3, 2e-3) * rng.choice((-1.0, 1.0)) for n in held
    }
    specimen = replace(specimen, chain=specimen.chain.changed(**off))
    return Case(
        taken=taken(specimen, *closed_walk(specimen, 40)),
        causes=("LENGTH.*", "GIVE.*", "FIXTURE_GIVES.*", "TOLERANCE.*", "DISCREPANCY.*"),
    )


def _case(make: Callable[..., Case], **how) -> Callable[[int], Case]:
    return lambda seed: make(seed, **how)


CASES: dict[str, Callable[[int], Case]] = {
    "3 poses": _case(few_poses, poses=3),
    "motion 1 deg": _case(little_motion, motion_deg=1.0),
    "motion 5 deg": _case(little_motion, motion_deg=5.0),
    "hinge slips 1 mm": _case(slipped_hinge, shift_m=1e-3),
    "hinge slips 5 mm": _case(slipped_hinge, shift_m=5e-3),
    "hinge turns 0.5 deg": _case(slipped_hinge, turn_deg=0.5),
    "1 outlier 0.5 deg": _case(odd_poses, poses=1),
    "3 outliers 0.5 deg": _case(odd_poses, poses=3),
    "3 flipped": _case(flipped, poses=3),
    "12 flipped": _case(flipped, poses=12),
    "RVDT 3 %": _case(bent_rvdt, percent=3.0),
    "RVDT 5 %": _case(bent_rvdt, percent=5.0),
    "RVDT stuck": stuck_rvdt,
    "RVDT saturated": saturated_rvdt,
    "joint slips 0.05 deg": _case(slipped_joint, deg=0.05, only=(1, 2, 3, 4, 5)),
    "joint slips 1 deg": _case(slipped_joint, deg=1.0),
    "joint slips 5 counts": _case(slipped_joint, counts=5, harmless=True),
    "joint slips 50 counts": _case(slipped_joint, counts=50),
    "encoder slips 500 counts": _case(slipped_joint, counts=500, only=(1, 2, 3, 4, 5)),
    "RVDT slips 0.05 deg": _case(slipped_joint, deg=0.05, only=(6, 7), harmless=True),
    "frozen for half": frozen,
    "hinge 5 deg from joint 1": _case(near_parallel, joint=1, deg=5.0),
    "hinge 1 deg from joint 1": _case(near_parallel, joint=1, deg=1.0),
    "hinge 0.5 deg from joint 1": _case(near_parallel, joint=1, deg=0.5),
    "hinge 5 deg from joint 7": _case(near_parallel, joint=7, deg=5.0),
    "hinge 1 deg from joint 7": _case(near_parallel, joint=7, deg=1.0),
    "hinge 0.5 deg from joint 7": _case(near_parallel, joint=7, deg=0.5),
    "radians": radians,
    "columns exchanged": exchanged,
    "a joint's sign": wrong_sign,
    "elbow 30 mm": _case(longer_elbow, mm=30.0),
    "elbow 5 mm": _case(longer_elbow, mm=5.0),
    "elbow 2 mm": _case(longer_elbow, mm=2.0, harmless=True),
    "ball for hinge": ball_for_hinge,
    "as_reported": as_reported,
}
"""The cases of the verdict, by name."""
