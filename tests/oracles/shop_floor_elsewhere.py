"""The shop floor's arms in poses that no wander gives: those of a plan, and those to which somebody leads the arm.

A plan is the product's own, made and carried out on one arm's true loop; others are read as near to its poses as
their loops close. What is read there shares no code with the product.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache

import numpy as np

from operator_app.config.procedure_file import load_procedure
from operator_app.planning.task import STOP_MARGIN_RAD, planning_task
from solver.design.actions import Capture, ChangeDrives, Finished, GoTo, path_watch
from solver.design.campaign import Campaign, CampaignSettings
from tests.oracles.shop_floor import (
    SCATTER,
    Session,
    Sizes,
    Specimen,
    Stream,
    stream,
    taken,
)
from tests.oracles.shop_floor_chain import Loop, frames
from tests.oracles.shop_floor_walk import (
    BOX_DEG,
    DRIVES,
    FOLLOW,
    HOME_DEG,
    STRAY_RAD,
    home_hinge_angle,
    in_range,
    nominal_chart,
)

DRIVE_SETS = ((1, 5), (2, 5), (2, 3))
STEP_RAD = np.deg2rad(2.0)
JUMP_RAD = 0.3
"""More than this in a step is another branch of the loop."""


def led_by_hand(seed: int, sizes: Sizes, *, poses: int) -> Session:
    """Poses anywhere in the boxes, in any order; whoever holds the arm there bends the hinge anew each time.

    What its halves give together is drawn for each pose, as large as stated: none of it is smooth with the load.
    """
    specimen, chart = Specimen.drawn(seed, sizes), nominal_chart()
    rng = np.random.default_rng([77_005, seed])
    low, high = np.deg2rad(np.array(BOX_DEG).T)
    places = low + rng.uniform(size=(4 * poses, 2)) * (high - low)
    guess = chart.near(places)
    columns = list(DRIVES)
    guess[:, columns] = chart.drives + specimen.chain.theta_off[columns] + places
    size = np.repeat([sizes.give_rad, sizes.give_m], 3) / np.sqrt(2.0)
    ground, hand = size * rng.normal(size=(2, len(places), 6))
    loop = Loop(chain=specimen.chain)
    angles, good = loop.closed(guess, free=FOLLOW, ground=ground, hand=hand)
    good &= np.abs(angles - guess).max(axis=-1) < STRAY_RAD
    good &= in_range((angles - specimen.chain.theta_off)[:, 1:])
    kept = np.flatnonzero(good)[:poses]
    if len(kept) < poses:
        raise RuntimeError(f"arm {seed}: {len(kept)} of {poses} places can be had")
    return taken(specimen, angles[kept], ground[kept], hand[kept])


def planned(seed: int, sizes: Sizes, plan: np.ndarray) -> Session:
    """Poses as near to those of a plan (k, 7), which was made for another arm, as this arm's loop closes."""
    specimen = Specimen.drawn(seed, sizes)
    near = np.zeros((len(plan), 8))
    near[:, 1:] = plan + specimen.chain.theta_off[1:]
    near[:, 0] = [home_hinge_angle(specimen.chain, angles) for angles in near]
    loop = Loop(chain=specimen.chain)
    rigid, good = loop.closed(near, free=tuple(range(8)))
    ground, hand = specimen.load.give(frames(specimen.chain, rigid), rigid)
    size = np.repeat([sizes.give_rad, sizes.give_m], 3)
    ground = ground + SCATTER * size * stream(seed, Stream.SCATTER).normal(size=ground.shape)
    angles, closed = loop.closed(rigid, free=tuple(range(8)), ground=ground, hand=hand)
    good &= closed & (np.abs(angles - near).max(axis=-1) < STRAY_RAD)
    if not good.all():
        raise RuntimeError(f"arm {seed} does not close at {np.flatnonzero(~good)}")
    return taken(specimen, angles, ground, hand)


@cache
def plan_of(seed: int, *, poses: int, candidates: int) -> np.ndarray:
    """Readings (k, 7), in order, that the product explores, plans and goes to on one arm of stated sizes."""
    given = load_procedure("hinge")
    led = _Led(Specimen.drawn(seed, Sizes()))
    task = planning_task(
        given.arm,
        given.fixture.fixture,
        drive_sets=DRIVE_SETS,
        samples=32,
        seed=seed,
        candidates=candidates,
    )
    campaign = Campaign(task=task, start_rad=led.readings, settings=CampaignSettings(poses=poses))
    found: list[np.ndarray] = []
    while True:
        match campaign.propose():
            case GoTo() as action:
                watch = path_watch(
                    action.trace_rad, action.tolerance_rad, task.ranges.within(STOP_MARGIN_RAD)
                )
                stopped = led.move(action.targets_rad, watch)
                campaign.observe(led.readings, stopped)
            case ChangeDrives():
                campaign.observe(led.readings)
            case Capture():
                found.append(led.readings)
                campaign.captured(led.readings)
            case Finished():
                return np.array(found)


class _Led:
    """A shop-floor arm whose drives are led, the loop closing after them."""

    def __init__(self, specimen: Specimen) -> None:
        self._loop = Loop(chain=specimen.chain)
        self._offsets = specimen.chain.theta_off
        home = np.concatenate(([0.0], np.deg2rad(HOME_DEG))) + self._offsets
        home[0] = home_hinge_angle(specimen.chain, home)
        (self._angles,), (good,) = self._loop.closed(home[None], free=FOLLOW)
        if not good:
            raise RuntimeError(f"arm {specimen.seed} does not close at home")

    @property
    def readings(self) -> np.ndarray:
        """What ideal sensors would read (7,)."""
        return (self._angles - self._offsets)[1:]

    def move(
        self, targets_rad: Mapping[int, float], watch: Callable[[np.ndarray], str | None]
    ) -> str:
        """Go straight and in step; why it ended early, "" where it did not."""
        columns = list(targets_rad)
        follow = tuple(j for j in range(8) if j not in targets_rad)
        start = self._angles[columns]
        way = np.array(list(targets_rad.values())) + self._offsets[columns] - start
        steps = max(1, int(np.ceil(np.abs(way).max() / STEP_RAD)))
        for k in range(1, steps + 1):
            guess = self._angles.copy()
            guess[columns] = start + way * (k / steps)
            (there,), (good,) = self._loop.closed(guess[None], free=follow, rounds=12)
            if not good or np.abs(there - self._angles).max() > JUMP_RAD:
                return "the loop does not close there"
            self._angles = there
            if reason := watch(self.readings):
                return reason
        return ""
