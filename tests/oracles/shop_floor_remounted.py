"""Simulated arms whose hinge was removed and mounted again, and readings of them at rest near home.

The kind "wild" has files with large errors: offsets by 25 deg, hinges by 40 mm and 15 deg in each placement.
"""

from dataclasses import dataclass, replace

import numpy as np

from tests.oracles.shop_floor import Session, Sizes, Specimen, taken, walked
from tests.oracles.shop_floor_chain import (
    HOME_DEG,
    Chain,
    Chart,
    Loop,
    chart,
    home_hinge_angle,
    in_range,
    nominal_chain,
    nominal_chart,
)

LENGTHS_OF_HINGE = ("a_0", "s_0", "s_1", "a_7", "s_7")
TWISTS_OF_HINGE = ("alpha_0", "alpha_7")
ENDS = ("theta_off_1", "theta_off_7")
"""Offsets that depend on the placement of the hinge."""

STATED_M, STATED_RAD = 0.03, np.deg2rad(10.0)
"""Tolerances of the hinge's file, three standard deviations."""
WILD_M, WILD_RAD, WILD_OFFSET_RAD = 0.04, np.deg2rad(15.0), np.deg2rad(25.0)
MAX_HOME_DISTANCE_RAD, STRAY_RAD = np.deg2rad(20.0), np.deg2rad(60.0)
"""Largest distance of a joint at rest from home, and of the same branch of the loop."""

KINDS = {
    "stated": Sizes(),
    "as_reported": Sizes(length_m=1.5e-3, give_m=1e-3, give_rad=2e-3),
    "wild": Sizes(),
}
MAX_ATTEMPTS = 200


@dataclass(frozen=True, kw_only=True)
class Remounted:
    """Poses of a first placement; readings (k, 7) at rest in the second, whose true chain is `chain`."""

    first: Session
    standing: np.ndarray
    chain: Chain


def remounted(kind: str, seed: int, *, poses: int, standings: int) -> Remounted:
    """Draw an arm and two placements in which its loop closes."""
    rng = np.random.default_rng([77_004, seed])
    for attempt in range(MAX_ATTEMPTS):
        arm_seed, own_chart = MAX_ATTEMPTS * seed + attempt, None
        specimen = Specimen.drawn(arm_seed, KINDS[kind])
        try:
            if kind == "wild":
                specimen, own_chart = _wild(specimen, rng)
            first = walked(specimen, poses, chart=own_chart)
        except RuntimeError:
            continue
        chain = _remount(specimen.chain, rng, wild=kind == "wild")
        standing_angles = _closed_near_home(chain, rng, standings)
        if standing_angles is not None:
            second = taken(replace(specimen, chain=chain), standing_angles, walk=1)
            return Remounted(first=first, standing=second.readings, chain=chain)
    raise RuntimeError(f"arm {seed} closes nowhere")


def _remount(chain: Chain, rng: np.random.Generator, *, wild: bool) -> Chain:
    """The same arm with a new placement of its hinge, relative to the file's."""
    nominal = nominal_chain()
    size_m, size_rad = (WILD_M, WILD_RAD) if wild else (STATED_M, STATED_RAD)

    def share() -> float:
        deviation = rng.uniform(-1.0, 1.0) if wild else rng.standard_normal() / 3.0
        return float(np.clip(deviation, -1.0, 1.0))

    changes = {n: nominal.value(n) + size_m * share() for n in LENGTHS_OF_HINGE}
    changes |= {n: nominal.value(n) + size_rad * share() for n in TWISTS_OF_HINGE}
    changes |= {n: chain.value(n) + size_rad * share() for n in ENDS}
    return chain.changed(**changes)


def _wild(specimen: Specimen, rng: np.random.Generator) -> tuple[Specimen, Chart]:
    """An arm whose home pose has the file's readings, with offsets of up to 25 deg."""
    reference = nominal_chart()
    middle = reference.angles[np.argmin(np.linalg.norm(reference.place, axis=-1))]
    home = np.concatenate(([0.0], np.deg2rad(HOME_DEG)))
    for _ in range(MAX_ATTEMPTS):
        chain = _remount(specimen.chain, rng, wild=True)
        deviation = np.concatenate(([0.0], WILD_OFFSET_RAD * rng.uniform(-1.0, 1.0, 7)))
        pose, closed = Loop(chain=chain).closed((middle + deviation)[None], free=tuple(range(8)))
        theta_off = pose[0] - home
        theta_off[0] = 0.0
        if closed[0] and np.abs(pose[0] - middle)[1:].max() < 2.0 * WILD_OFFSET_RAD:
            chain = replace(chain, theta_off=theta_off)
            return replace(specimen, chain=chain), chart(chain, pose[0])
    raise RuntimeError("no wild arm closes")


def _closed_near_home(chain: Chain, rng: np.random.Generator, count: int) -> np.ndarray | None:
    """Closed true angles (count, 8) near home, or None if there are too few."""
    home = np.concatenate(([0.0], np.deg2rad(HOME_DEG))) + chain.theta_off
    home[0] = home_hinge_angle(chain, home)
    guess = np.tile(home, (MAX_ATTEMPTS, 1))
    guess[:, 1:] += rng.uniform(-MAX_HOME_DISTANCE_RAD, MAX_HOME_DISTANCE_RAD, (MAX_ATTEMPTS, 7))
    pose, closed = Loop(chain=chain).closed(guess, free=tuple(range(8)), rounds=20)
    closed &= in_range((pose - chain.theta_off)[:, 1:])
    closed &= np.abs(pose - home)[:, 1:].max(axis=-1) < STRAY_RAD
    poses = pose[closed]
    return poses[:count] if len(poses) >= count else None
