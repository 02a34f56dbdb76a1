"""Explores with the drive joints, guided by readings alone, before any model can be trusted.

The policy commands no arm: `propose` returns the next targets of the drives, `observe` takes the readings at the end of
a move and, if the move ended early, the reason. The drives leave the start in small steps along a ray in drive space,
return in one move, and take the next ray. The motion of all joints per motion of each drive is learnt from the steps
(Broyden's secant update) and predicts whether the next step would reach the end of a range or a singularity.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from solver.arrays import FloatArray
from solver.design.actions import Capture, GoTo
from solver.design.motion import Ranges

WIGGLE_RAD = float(np.deg2rad(1.5))
"""Length of the first steps, from which the rates of the joints are determined."""
RAY_STEP_RAD = float(np.deg2rad(4.0))
"""Length of a step of the drives."""
REACH_RAD = float(np.deg2rad(28.0))
"""Length of a ray."""
CAPTURE_EVERY = 3
"""Number of steps from one captured pose to the next; with a single drive, every step is captured."""
RAY_MARGIN_RAD = float(np.deg2rad(5.0))
"""Smallest allowed distance of every joint from the ends of its range."""
MOST_RATE = 2.5
"""Largest allowed ratio of a passive joint's motion to that of the drives: a larger ratio shows a singularity nearby.
If 1.3 times the ratio at the start is larger, it is the limit instead, up to twice this constant."""


@dataclass(slots=True)
class _Ray:
    """A direction in drive space, the number of steps along it, and why the ray ended early ("" if it did not)."""

    direction: FloatArray
    steps: int
    ended: str = ""


class Explorer:
    """Proposes moves along rays. Alternate `propose` and `observe` until `propose` returns an empty tuple.

    A ray is a series of steps of the drives in one direction, away from the start, and a return to the start.
    `start_rad` (n,): readings at the start. `drives`: joints (1-based) in position mode. `ranges`: of every joint.
    """

    def __init__(self, *, start_rad: FloatArray, drives: tuple[int, ...], ranges: Ranges) -> None:
        self.drives = drives
        self._ranges = ranges
        self._columns = [j - 1 for j in drives]
        self._start = np.array(start_rad)
        self._start_rates = np.zeros((len(start_rad), len(drives)))
        self._start_rates[self._columns, range(len(drives))] = 1.0
        self._q, self._moved, self._stopped = self._start, np.zeros_like(self._start), ""
        self.rays = self._plan_rays()
        self.failure = ""
        self._proposed: tuple[GoTo | Capture, ...] = ()
        self._moves = self._explore()

    def propose(self) -> tuple[GoTo | Capture, ...]:
        """Return the next move, followed by a capture if the pose at the end of the move is to be measured.

        The result is empty when the exploration is over (`failure` is the reason if it failed).
        """
        self._proposed = self._proposed or next(self._moves, ())
        return self._proposed

    def observe(self, q_rad: FloatArray, stopped: str = "") -> None:
        """Report the readings (n,) at the end of the proposed move; `stopped` says why it ended early."""
        self._proposed = ()
        self._moved, self._q, self._stopped = q_rad - self._q, np.array(q_rad), stopped

    def _plan_rays(self) -> list[_Ray]:
        count = len(self.drives)
        unit = np.eye(count)
        wiggles = [_Ray(direction=s * e, steps=1) for e in unit for s in (1.0, -1.0)]
        signs = [v for v in product((1.0, -1.0, 0.0), repeat=count) if any(v)]
        signs.sort(key=lambda v: sum(map(abs, v)))
        steps = int(REACH_RAD / RAY_STEP_RAD)
        # On a diagonal each drive moves as far as on a ray of its own.
        return wiggles + [_Ray(direction=np.array(v), steps=steps) for v in signs]

    def _explore(self) -> Iterator[tuple[GoTo | Capture, ...]]:
        """Yield the moves along all rays and back to the start; `observe` stores the readings after each move."""
        trials = 2 * len(self.drives)
        # One drive has two rays and no diagonals: every step is captured.
        every = 1 if len(self.drives) == 1 else CAPTURE_EVERY
        for number, ray in enumerate(self.rays, 1 - trials):
            is_trial, taken = number < 1, 0
            move = (WIGGLE_RAD if is_trial else RAY_STEP_RAD) * ray.direction
            # At the start the rates learnt from the trial motions apply.
            rates, rate, growth = self._start_rates, self._start_rate(ray.direction), 1.0
            while taken < ray.steps and not ray.ended:
                ray.ended = self._ahead(move, rates, growth, trusted=not is_trial)
                if ray.ended:
                    break
                taken += 1
                why = f"exploring, ray {number}, step {taken}"
                if is_trial:
                    why = "small trial motion that shows how the other joints follow"
                capture = Capture(planned=False)
                is_captured = not is_trial and taken % every == 0
                yield self._move(self._q[self._columns] + move, why), *(capture,) * is_captured
                moved, by = np.abs(self._moved), self._moved[self._columns]
                length = float(np.linalg.norm(by))
                if length > 0.2 * WIGGLE_RAD:
                    rates = rates + np.outer(self._moved - rates @ by, by) / length**2
                    before, rate = rate, float(moved.max()) / float(np.abs(by).max())
                    # Growth per step. The first step's mean rate applies half a step after the start: hence the square.
                    ratio = rate / before if before > 0.0 else 1.0
                    growth = max(1.0, ratio if taken > 1 else ratio**2)
                    if rate > self._most_rate(ray.direction):
                        joint = int(np.argmax(moved)) + 1
                        ray.ended = f"joint {joint} moved {rate:.1f} times as far as the drives"
                elif not self._stopped:
                    ray.ended = "the drives did not move"
                ray.ended = self._stopped or ray.ended
            if taken:
                yield from self._return(ray)
            if self.failure:
                return
            if is_trial:
                self._start_rates = rates

    def _return(self, ray: _Ray) -> Iterator[tuple[GoTo, ...]]:
        """Yield moves to the start until the arm is there; set `failure` after three moves that do not reach it."""
        home = self._start[self._columns]
        for _ in range(3):
            yield (self._move(home, f"back to the start ({ray.ended or 'the end of the ray'})"),)
            if np.abs(self._q[self._columns] - home).max() <= 0.5 * WIGGLE_RAD:
                return
        self.failure = f"the arm does not return to the start: {self._stopped or 'it stopped'}"

    def _ahead(self, move: FloatArray, rates: FloatArray, growth: float, *, trusted: bool) -> str:
        """Return why the drives must not take the step `move` (d,), rad, or "" if they may.

        `rates` (n, d): motion of the joints per motion of the drives. `trusted`: whether `rates` are reliable; if not,
        any joint may move at the largest allowed rate. `growth`: factor by which rates grow from step to step.
        """
        change = rates @ move
        slack = RAY_MARGIN_RAD + 0.3 * np.abs(change)
        if not trusted:
            slack = np.full(len(change), 2.0 * MOST_RATE * np.abs(move).max())
        after = self._q + change
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
        rate = np.abs(change) / np.abs(move).max() * growth**1.5
        if trusted and float(rate.max()) > self._most_rate(move):
            return f"joint {int(np.argmax(rate)) + 1} would move too far: a singularity is near"
        return ""

    def _most_rate(self, direction: FloatArray) -> float:
        """Largest allowed ratio of a joint's motion to the drives' motion while the drives move in `direction`."""
        return float(np.clip(1.3 * self._start_rate(direction), MOST_RATE, 2.0 * MOST_RATE))

    def _start_rate(self, direction: FloatArray) -> float:
        """Largest ratio of a joint's motion to the drives' motion at the start, if the drives move in `direction`."""
        return float(np.abs(self._start_rates @ direction).max() / np.abs(direction).max())

    def _move(self, target: FloatArray, reason: str) -> GoTo:
        return GoTo(targets_rad=dict(zip(self.drives, target.tolist(), strict=True)), why=reason)
