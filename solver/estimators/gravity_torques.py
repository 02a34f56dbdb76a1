"""Gravity's torque on every joint at the poses of a placement, by stated and by uncertain masses.

Knows a closure model's table and the arm's masses; no fixture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.kinematics import Frames, forward
from solver.chain.parameters import DhEntry, DhKind, is_entry
from solver.chain.statics import LinkMasses, torque_rates
from solver.loops.closure import ClosureModel


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmPoses:
    """Poses q (m, n) and unsensed angles u (m, U), rad, of one placement at parameters x (P,)."""

    model: ClosureModel
    x: FloatArray
    q: FloatArray
    u: FloatArray
    masses: LinkMasses

    def arm(self, poses: IntArray | slice) -> Frames:
        """Frames 0..n of the arm alone."""
        rows = self.arm_rows()
        angle = self.q[poses] + rows[DhKind.THETA_OFF]
        return forward(angle, *rows[DhKind.S :])

    def arm_rows(self) -> FloatArray:
        """D-H rows 1..n (5, n) of the arm alone.

        The offsets of the first and the last joint are those of the arm's file: calibrated ones are
        counted from the fixture's axis, and neither gravity nor the hand's centre knows of that.
        """
        rows = self.model.arm_rows().copy()
        ends = {f"{DhKind.THETA_OFF.symbol}_{j}" for j in (1, rows.shape[1])}
        for parameter, value in zip(self.model.parameters, self.x, strict=True):
            if is_entry(parameter.name) and parameter.name not in ends:
                entry = DhEntry.parse(parameter.name)
                if entry.row > 0:
                    rows[int(entry.kind), entry.row - 1] = value
        return rows

    @property
    def shapes(self) -> int:
        """Number s of shapes of a torque."""
        return 1 + 4 * len(self.masses.mass_kg) + len(self.masses.tilted)

    def torques(self, poses: slice) -> FloatArray:
        """Gravity's torque (m, n, s): as stated, by uncertain moments, by a tilted base."""
        arm, masses = self.arm(poses), self.masses
        rates = torque_rates(arm, np.vstack((masses.down, masses.tilted)))
        stated, *tilts = (rates * masses.moments).sum((-1, -2))
        shapes = (stated[..., None], by_moment(rates[0], masses), np.stack(tilts, axis=-1))
        return np.concatenate(shapes, axis=-1)


def by_moment(rates: FloatArray, masses: LinkMasses) -> FloatArray:
    """Torque (m, n, 4 n) for a unit of each uncertain moment."""
    m, n = rates.shape[:2]
    # One product for every link: all joints at all poses with its moments.
    by_link = rates.transpose(2, 0, 1, 3).reshape(n, m * n, 4) @ masses.moments_sd
    return by_link.reshape(n, m, n, 4).transpose(1, 2, 0, 3).reshape(m, n, -1)
