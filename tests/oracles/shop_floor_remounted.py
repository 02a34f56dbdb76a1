"""The shop floor's arms in a hinge that was taken off and mounted anew, and where such an arm stands then.

Shares no code with `solver`. `WILD` are arms whose files are wrong in everything: offsets by 25 deg, hinges by
40 mm and 15 deg, each time they are mounted.
"""

from dataclasses import dataclass, replace

import numpy as np

from tests.oracles.shop_floor import Session, Sizes, Specimen, closed_walk, taken
from tests.oracles.shop_floor_chain import Chain, Loop
from tests.oracles.shop_floor_walk import (
    HOME_DEG,
    Chart,
    chart,
    home_hinge_angle,
    in_range,
    nominal_chain,
    nominal_chart,
)

LENGTHS_OF_HINGE = ("a_0", "s_0", "s_1", "a_7", "s_7")
TWISTS_OF_HINGE = ("alpha_0", "alpha_7")
ENDS = ("theta_off_1", "theta_off_7")
"""Counted from the hinge, wherever that is."""

STATED_M, STATED_RAD = 0.03, np.deg2rad(10.0)
"""What the hinge's file allows, three standard deviations."""
WILD_M, WILD_RAD, WILD_OFFSET_RAD = 0.04, np.deg2rad(15.0), np.deg2rad(25.0)
AWAY_RAD, STRAY_RAD = np.deg2rad(20.0), np.deg2rad(60.0)
"""How far from home somebody leaves a joint when it is mounted, and what is another branch of the loop."""

KINDS = {
    "stated": Sizes(),
    "as_reported": Sizes(length_m=1.5e-3, give_m=1e-3, give_rad=2e-3),
    "wild": Sizes(),
}
ENOUGH = 200


@dataclass(frozen=True, kw_only=True)
class Remounted:
    """Poses of a first placement, and readings (k, 7) of where the arm stood in the second, `chain` its truth."""

    first: Session
    standing: np.ndarray
    chain: Chain


def remounted(kind: str, seed: int, *, poses: int, standings: int) -> Remounted:
    """Draw an arm and both placements; what does not close is drawn again."""
    rng = np.random.default_rng([77_004, seed])
    for again in range(ENOUGH):
        number, own = ENOUGH * seed + again, None
        specimen = Specimen.drawn(number, KINDS[kind])
        try:
            if kind == "wild":
                specimen, own = _wild(specimen, rng)
            angles, ground, hand = closed_walk(specimen, poses, chart=own)
        except RuntimeError:
            continue
        anew = _anew(specimen.chain, rng, wild=kind == "wild")
        there = _standings(anew, rng, standings)
        if there is not None:
            still = np.zeros((standings, 6))
            second = taken(replace(specimen, chain=anew), there, still, still, walk=1)
            first = taken(specimen, angles, ground, hand)
            return Remounted(first=first, standing=second.readings, chain=anew)
    raise RuntimeError(f"arm {seed} closes nowhere")


def _anew(chain: Chain, rng: np.random.Generator, *, wild: bool) -> Chain:
    """The same arm where its hinge is somewhere else, seen from the file's place."""
    nominal = nominal_chain()
    size_m, size_rad = (WILD_M, WILD_RAD) if wild else (STATED_M, STATED_RAD)

    def share() -> float:
        drawn = rng.uniform(-1.0, 1.0) if wild else rng.standard_normal() / 3.0
        return float(np.clip(drawn, -1.0, 1.0))

    changes = {n: nominal.value(n) + size_m * share() for n in LENGTHS_OF_HINGE}
    changes |= {n: nominal.value(n) + size_rad * share() for n in TWISTS_OF_HINGE}
    changes |= {n: chain.value(n) + size_rad * share() for n in ENDS}
    return chain.changed(**changes)


def _wild(specimen: Specimen, rng: np.random.Generator) -> tuple[Specimen, Chart]:
    """An arm whose home reads as its file says, and is anywhere within 25 deg of that."""
    near = nominal_chart()
    middle = near.angles[np.argmin(np.linalg.norm(near.place, axis=-1))]
    home = np.concatenate(([0.0], np.deg2rad(HOME_DEG)))
    for _ in range(ENOUGH):
        chain = _anew(specimen.chain, rng, wild=True)
        away = np.concatenate(([0.0], WILD_OFFSET_RAD * rng.uniform(-1.0, 1.0, 7)))
        pose, closed = Loop(chain=chain).closed((middle + away)[None], free=tuple(range(8)))
        off = pose[0] - home
        off[0] = 0.0
        if closed[0] and np.abs(pose[0] - middle)[1:].max() < 2.0 * WILD_OFFSET_RAD:
            chain = replace(chain, theta_off=off)
            return replace(specimen, chain=chain), chart(chain, pose[0])
    raise RuntimeError("no wild arm closes")


def _standings(chain: Chain, rng: np.random.Generator, count: int) -> np.ndarray | None:
    """True angles (count, 8) near home where the loop closes; None where it hardly does."""
    home = np.concatenate(([0.0], np.deg2rad(HOME_DEG))) + chain.theta_off
    home[0] = home_hinge_angle(chain, home)
    guess = np.tile(home, (ENOUGH, 1))
    guess[:, 1:] += rng.uniform(-AWAY_RAD, AWAY_RAD, (ENOUGH, 7))
    pose, closed = Loop(chain=chain).closed(guess, free=tuple(range(8)), rounds=20)
    closed &= in_range((pose - chain.theta_off)[:, 1:])
    closed &= np.abs(pose - home)[:, 1:].max(axis=-1) < STRAY_RAD
    found = pose[closed]
    return found[:count] if len(found) >= count else None
