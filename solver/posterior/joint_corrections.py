"""What the joints are off their readings at any pose, by a fit's effects along them: mean and covariance.

Encoder harmonics, RVDT gain and linearity, the side of play and gravity's twist (method, section 10,
"Corrections"). What a fixture gives belongs to the mounting and is none of the arm's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.estimators.joint_shapes import JointPoses, JointShapes
from solver.estimators.layout import NO_SHAPES
from solver.estimators.linear_fit import LinearFit
from solver.estimators.load_shapes import shapes_of_sag, sides_of_play


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointsThere:
    """What corrections are made of at m poses.

    Attributes
    ----------
    q
        Readings (m, n), rad.
    shapes
        (m, c), rad for a unit of each coefficient.
    expected
        Correction (m, n), rad, that is expected before anything is fitted.
    side
        Expected side (m, n) of every joint's play, part of that.
    """

    q: FloatArray
    shapes: FloatArray
    expected: FloatArray
    side: FloatArray

    def first(self, count: int) -> JointsThere:
        """Return the same of the first poses."""
        return JointsThere(
            q=self.q[:count], shapes=self.shapes[:count], expected=self.expected[:count],
            side=self.side[:count],
        )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointCorrections:
    """Effects along the joints of a fit.

    Attributes
    ----------
    fit
        The linear fit, at its solution.
    first, end
        Columns of the fit (of its whole width) that act along a joint.
    """

    fit: LinearFit
    first: int
    end: int

    @classmethod
    def of(cls, fit: LinearFit) -> JointCorrections:
        """Take them out of a fit."""
        design = fit.design
        first = design.hard + len(design.soft_index)
        return cls(fit=fit, first=first, end=first + len(design.along_joints.joint_of))

    @property
    def joint_of(self) -> IntArray:
        """0-based joint (c,) of each column."""
        return self.fit.design.along_joints.joint_of

    @property
    def coefficients(self) -> FloatArray:
        """Posterior mean (c,)."""
        design = self.fit.design
        return self.fit.b[self.first - design.hard : self.end - design.hard]

    def at(self, q: FloatArray) -> JointsThere:
        """Return the shapes of the corrections at readings q (m, n), rad."""
        design = self.fit.design
        errors, m = design.errors, len(q)
        there = replace(
            errors,
            loads=None if errors.loads is None else errors.loads.joints_at(q),
            # From which side a joint will come is not known: neither side of that play is.
            approach=None if errors.approach is None else np.zeros_like(q),
        )
        play = sides_of_play(q, there)
        expected = design.backlash * play.expected
        sags = NO_SHAPES
        if len(design.sag_joints):
            sags = shapes_of_sag(q, there, design.sag_basis)
            expected = expected + design.sag * sags.expected
        along = JointShapes(design, JointPoses(q=q, play=play, sags=sags))
        return JointsThere(
            shapes=along.at(q, slice(0, m)), q=q, expected=expected, side=play.expected
        )

    def with_parameters(self, index: IntArray) -> FloatArray:
        """Covariance (k + c, k + c) of parameters (k,), by their place among all, and the coefficients; rad, m, 1."""
        fit, design = self.fit, self.fit.design
        soft = len(design.soft_index)
        place = np.argsort(np.concatenate((design.hard_index, design.soft_index)))
        columns = np.concatenate((place[index], np.arange(self.first, self.end)))
        size = np.ones(design.width)
        size[design.hard :] = fit.root
        size[design.hard : design.hard + soft] *= design.soft_sd
        block = fit.H_inverse[np.ix_(columns, columns)] * np.outer(size[columns], size[columns])
        return np.asarray(0.5 * (block + block.T))

    def mean(self, q: FloatArray) -> FloatArray:
        """Corrections (m, n), rad, to be added to readings q (m, n)."""
        there = self.at(q)
        along = np.zeros((len(self.joint_of), q.shape[1]))
        along[np.arange(len(along)), self.joint_of] = self.coefficients
        return np.asarray(there.expected + there.shapes @ along)
