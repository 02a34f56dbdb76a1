"""Synchronised straight move of several joints with bounded jerk, which can brake at any time and start again.

The move is a straight line in joint space. Distance along the line is the angle turned so far by the joint that moves
farthest; the speed of this joint follows a trapezoidal profile. A moving average over `SMOOTHING_PERIODS` positions
bounds the jerk. All joints stay on the line and come to rest exactly at its end.
"""

import math
from collections import deque

import numpy as np

from hardware.arm import FloatArray
from hardware.canopen.objects import CONTROL_PERIOD_S

ACCELERATION_RAD_PER_S2 = 1.0
"""Acceleration and deceleration of joints."""
SMOOTHING_PERIODS = 10
"""Length of the moving average; the jerk stays below 2 * acceleration / (SMOOTHING_PERIODS * control period)."""


def coming_to_rest_s(speed_rad_per_s: float) -> float:
    """Return a joint's braking distance divided by its speed, s, for a move at `speed_rad_per_s`.

    The result is half the deceleration time (the mean speed is half of `speed_rad_per_s`), plus half the length of the
    moving average and two control periods of delay. It also holds for a free joint that moves along with driven ones.
    """
    delay_s = (0.5 * (SMOOTHING_PERIODS - 1) + 2.0) * CONTROL_PERIOD_S
    return 0.5 * speed_rad_per_s / ACCELERATION_RAD_PER_S2 + delay_s


class Trapezoid:
    """Trapezoidal speed profile from rest to rest over `length` (rad, >= 0), at most at `speed` (rad/s, > 0)."""

    def __init__(self, *, length: float, speed: float) -> None:
        self._speed = min(speed, math.sqrt(length * ACCELERATION_RAD_PER_S2))
        self._ramp_s = self._speed / ACCELERATION_RAD_PER_S2
        cruise = length - self._speed * self._ramp_s
        self._cruise_s = cruise / self._speed if self._speed > 0.0 else 0.0
        self._length = length
        self._brake_from_s = math.inf
        self.end_s = 2.0 * self._ramp_s + self._cruise_s

    def at(self, time_s: float) -> tuple[float, float]:
        """Return distance (rad) and speed (rad/s) at `time_s` after the start."""
        if time_s <= self._brake_from_s:
            return self._planned(time_s)
        distance, speed = self._planned(self._brake_from_s)
        braking = min(time_s - self._brake_from_s, speed / ACCELERATION_RAD_PER_S2)
        distance += (speed - 0.5 * ACCELERATION_RAD_PER_S2 * braking) * braking
        return distance, speed - ACCELERATION_RAD_PER_S2 * braking

    def brake(self, time_s: float) -> None:
        """Decelerate to rest from `time_s` on; further calls change nothing."""
        if self._brake_from_s <= time_s:
            return
        _, speed = self.at(time_s)
        self._brake_from_s = time_s
        self.end_s = min(self.end_s, time_s + speed / ACCELERATION_RAD_PER_S2)

    def _planned(self, time_s: float) -> tuple[float, float]:
        a, v = ACCELERATION_RAD_PER_S2, self._speed
        if time_s < self._ramp_s:
            return 0.5 * a * time_s**2, a * time_s
        if time_s < self._ramp_s + self._cruise_s:
            return v * (time_s - 0.5 * self._ramp_s), v
        remaining_s = 2.0 * self._ramp_s + self._cruise_s - time_s
        if remaining_s > 0.0:
            return self._length - 0.5 * a * remaining_s**2, a * remaining_s
        return self._length, 0.0


class StraightMove:
    """Targets of a straight synchronised move between joint angles of shape (n,), one vector per control period."""

    def __init__(
        self, start_rad: FloatArray, end_rad: FloatArray, *, speed_rad_per_s: float
    ) -> None:
        self._speed = speed_rad_per_s
        self._target = np.array(start_rad, dtype=np.float64)
        self._end = np.asarray(end_rad, dtype=np.float64)
        self.braking = self.finished = False
        """Whether `brake` was called, and whether the last target returned was the final one."""
        self.start_from_rest()

    def start_from_rest(self) -> None:
        """Plan the remaining move from standstill at the last target; no effect while braking."""
        if self.braking:
            return
        self._start = self._target
        way = self._end - self._start
        self._length = float(np.abs(way).max(initial=0.0))
        self._end = self._start + way
        self._direction = way / self._length if self._length > 0.0 else way
        self._line = Trapezoid(length=self._length, speed=self._speed)
        self._window = deque([0.0] * SMOOTHING_PERIODS, maxlen=SMOOTHING_PERIODS)
        self._step = 0
        self.finished = self._length == 0.0

    def next(self) -> FloatArray:
        """Return the target of the next control period, shape (n,), rad; after the end, the final target."""
        distance = self._window[-1]
        if not self.finished:
            self._step += 1
            time_s = self._step * CONTROL_PERIOD_S
            distance, _ = self._line.at(time_s)
            self._window.append(distance)
            # Once the window is constant the joints are at rest; its mean would have a rounding error.
            self.finished = time_s >= self._line.end_s and self._window[0] == distance
            if not self.finished:
                distance = math.fsum(self._window) / len(self._window)
        at_end = distance >= self._length
        self._target = self._end if at_end else self._start + distance * self._direction
        return self._target.copy()

    def brake(self) -> None:
        """Start braking: from now on, `next` returns targets that bring the joints to rest."""
        if not self.braking:
            self.braking = True
            self._line.brake(self._step * CONTROL_PERIOD_S)
