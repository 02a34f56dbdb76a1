"""Explores with the drive joints, guided by readings alone, before any model can be trusted.

A policy without an arm: `propose` returns the next targets of the drives, `observe` takes the readings at the end of a
move and why it ended early, if it did. The drives leave the start in small steps along a ray in drive space, return in
one move, and take the next ray. The rate of every joint per drive is learnt from the steps (Broyden's secant update)
and predicts whether the next step would reach the end of a range or a singularity.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from solver.arrays import FloatArray, frozen
from solver.design.actions import Capture, GoTo
from solver.design.motion import Ranges

WIGGLE_RAD = float(np.deg2rad(1.5))
"""Length of the first steps, from which rates are learnt."""
RAY_STEP_RAD = float(np.deg2rad(4.0))
"""Length of a step of the drives."""
REACH_RAD = float(np.deg2rad(28.0))
"""Length of a ray."""
CAPTURE_EVERY = 3
"""Steps between captured poses; with a single drive, every step is captured."""
RAY_MARGIN_RAD = float(np.deg2rad(5.0))
"""Least distance of every joint from the ends of its range."""
MOST_RATE = 2.5
"""Largest allowed ratio of a passive joint's motion to the drives'; more means that a singularity is near. If 1.3
times the ratio at the start exceeds this limit, that much is allowed, but at most twice the limit."""


@dataclass(slots=True)
class _Ray:
    """A direction in drive space, the number of steps along it, and why the ray ended early ("" if it did not)."""

    direction: FloatArray
    steps: int
    ended: str = ""


@dataclass(slots=True)
class _Here:
    """Latest readings, and the joints' rates at these readings."""

    q: FloatArray
    rates: FloatArray
    rate: float = 0.0
    growth: float = 1.0
    on_ray: int = 0
    away: bool = False
    returning: int = 0


class Explorer:
    """Policy of the exploration. Alternate `propose` and `observe` until `propose` returns an empty tuple.

    `start_rad`: readings at the start (n,), to which every ray returns. `drives`: joints (1-based) in position mode.
    `ranges`: ranges of all joints, sensor coordinates.
    """

    def __init__(self, *, start_rad: FloatArray, drives: tuple[int, ...], ranges: Ranges) -> None:
        self.drives = drives
        self._ranges = ranges
        self._columns = [j - 1 for j in drives]
        self._start = frozen(start_rad)
        self._start_rates = np.zeros((len(start_rad), len(drives)))
        self._start_rates[self._columns, range(len(drives))] = 1.0
        self._here = _Here(q=np.array(start_rad), rates=self._start_rates.copy())
        # One drive has two rays and no diagonals: every step is captured.
        self._every = 1 if len(drives) == 1 else CAPTURE_EVERY
        self.rays = self._plan_rays()
        self._ray = 0
        self._pending: FloatArray | None = None
        self.failure = ""

    def propose(self) -> tuple[GoTo | Capture, ...]:
        """Return the next move, followed by a capture if the pose at the end of the move is to be measured.

        The result is empty when the exploration is over (`failure` is the reason if it failed).
        """
        if self.failure:
            return ()
        while self._ray < len(self.rays):
            ray = self.rays[self._ray]
            if ray.ended or self._here.on_ray >= ray.steps:
                if self._here.away:
                    return self._return(ray)
                self._finish()
                continue
            wiggle = self._ray < 2 * len(self.drives)
            step = WIGGLE_RAD if wiggle else RAY_STEP_RAD
            move = step * ray.direction
            ray.ended = self._ahead(move, trusted=not wiggle)
            if ray.ended:
                continue
            target = self._here.q[self._columns] + move
            steps = self._here.on_ray + 1
            if wiggle:
                return self._move(
                    target, "small trial motion that shows how the other joints follow"
                )
            why = f"exploring, ray {self._ray - 2 * len(self.drives) + 1}, step {steps}"
            capture = Capture(planned=False, why=why)
            return self._move(target, why) + (capture,) * (steps % self._every == 0)
        return ()

    def observe(self, q_rad: FloatArray, stopped: str = "") -> None:
        """Report the readings (n,) at the end of the proposed move; `stopped` says why it ended early.

        Raises `ValueError` if no move was proposed.
        """
        if self._pending is None:
            raise ValueError("nothing was proposed")
        start, ray = self._here, self.rays[self._ray]
        target, self._pending = self._pending, None
        displacement, by = q_rad - start.q, (q_rad - start.q)[self._columns]
        start.q = np.array(q_rad)
        length = float(np.linalg.norm(by))
        if start.returning:
            self._observe_return(target, stopped)
            return
        start.away = True
        start.on_ray += 1
        if length > 0.2 * WIGGLE_RAD:
            start.rates = start.rates + np.outer(displacement - start.rates @ by, by) / length**2
            fastest = int(np.argmax(np.abs(displacement)))
            rate = float(np.abs(displacement[fastest])) / float(np.abs(by).max())
            # Growth per step. A first step's mean rate follows that at its start after half a step: squared.
            before = start.rate if start.on_ray > 1 else self._start_rate(ray.direction)
            ratio = rate / before if before > 0.0 else 1.0
            start.growth = max(1.0, ratio if start.on_ray > 1 else ratio**2)
            start.rate = rate
            if rate > self._most_rate(ray.direction):
                ray.ended = f"joint {fastest + 1} moved {rate:.1f} times as far as the drives"
        elif not stopped:
            ray.ended = "the drives did not move"
        if stopped:
            ray.ended = stopped

    def _plan_rays(self) -> list[_Ray]:
        """Plan trial motions of each drive, then rays: first along single drives, then diagonal."""
        count = len(self.drives)
        unit = np.eye(count)
        wiggles = [_Ray(direction=s * e, steps=1) for e in unit for s in (1.0, -1.0)]
        signs = [np.array(v, dtype=np.float64) for v in product((1.0, -1.0, 0.0), repeat=count)]
        signs = [v for v in signs if np.any(v)]
        signs.sort(key=lambda v: int(np.abs(v).sum()))
        steps = int(REACH_RAD / RAY_STEP_RAD)
        # On a diagonal each drive moves as far as on a ray of its own.
        return wiggles + [_Ray(direction=v, steps=steps) for v in signs]

    def _ahead(self, move: FloatArray, *, trusted: bool) -> str:
        """Reason not to make the step `move` (d,), rad; "" if none. `trusted`: whether the rates are learnt."""
        start = self._here
        change = start.rates @ move
        # Until the rates are learnt, assume the largest allowed rate.
        slack = RAY_MARGIN_RAD + 0.3 * np.abs(change)
        if not trusted:
            slack = np.full(len(change), 2.0 * MOST_RATE * np.abs(move).max())
        after = start.q + change
        low = after - slack < self._ranges.lower_rad
        high = after + slack > self._ranges.upper_rad
        outward = (low & (change <= 0.0)) | (high & (change >= 0.0))
        if trusted:
            outward &= change != 0.0
        if np.any(outward):
            joint = int(np.flatnonzero(outward)[0]) + 1
            return f"joint {joint} would come close to the end of its range"
        # Towards a singularity rates grow faster and faster. Learnt rates are means over the last step, so the end of
        # the next step is one and a half steps away.
        rate = np.abs(change) / np.abs(move).max() * start.growth**1.5
        if trusted and float(rate.max()) > self._most_rate(move):
            return f"joint {int(np.argmax(rate)) + 1} would move too far: a singularity is near"
        return ""

    def _most_rate(self, direction: FloatArray) -> float:
        """Largest allowed ratio of a joint's motion to the drives' along a ray in this direction."""
        return float(np.clip(1.3 * self._start_rate(direction), MOST_RATE, 2.0 * MOST_RATE))

    def _start_rate(self, direction: FloatArray) -> float:
        """Largest ratio, at the start, of a joint's motion to the drives' in this direction."""
        return float(np.abs(self._start_rates @ direction).max() / np.abs(direction).max())

    def _return(self, ray: _Ray) -> tuple[GoTo, ...]:
        self._here.returning += 1
        why = f"back to the start ({ray.ended or 'the end of the ray'})"
        return self._move(self._start[self._columns], why)

    def _observe_return(self, target: FloatArray, stopped: str) -> None:
        start = self._here
        gap = float(np.abs(start.q[self._columns] - target).max())
        if gap > 0.5 * WIGGLE_RAD:
            if start.returning >= 3:
                self.failure = f"the arm does not return to the start: {stopped or 'it stopped'}"
            return
        start.returning = 0
        start.away = False
        self._finish()

    def _finish(self) -> None:
        """End the ray: the arm is back at the start, where the rates learnt from the trial motions apply."""
        if self._ray < 2 * len(self.drives):
            self._start_rates = self._here.rates.copy()
        self._here.rates = self._start_rates.copy()
        self._here.on_ray, self._here.rate, self._here.growth = 0, 0.0, 1.0
        self._ray += 1

    def _move(self, target: FloatArray, reason: str) -> tuple[GoTo, ...]:
        """Propose a straight move of the drives to `target` (d,)."""
        self._pending = target
        return (GoTo(targets_rad=dict(zip(self.drives, target.tolist(), strict=True)), why=reason),)
