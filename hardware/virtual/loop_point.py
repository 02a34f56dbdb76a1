"""Closure error and Jacobian at one pose, optimised for speed in the plant's inner loop.

`solver.loops.dh.DhLoop.loop` does the same for many poses at once, and is ten times slower for one pose. A test
compares the two to within 1e-12.
"""

from __future__ import annotations

import math

import numpy as np

from solver.arrays import FloatArray
from solver.chain.kinematics import DhTable

_CYCLIC = np.array([0, 1, 2, 0, 1])


class ChainPoint:
    """Evaluates ``A_0(theta_0) A_1 ... A_n`` at one pose; every call of `at` overwrites the previous result.

    This class is for an open arm and has no closure error; subclasses add one.

    Attributes
    ----------
    error
        (k,) closure error; its components are stated by the subclass.
    jacobian
        (k, n + 1) derivative of `error` with respect to theta_0, theta'_1 .. theta'_n; column 0 is zero without a
        hinge.
    axes_z, origins_m
        (n + 2, 3) z axis and origin of frames -1 .. n, in frame -1.
    """

    def __init__(self, table: DhTable, components: int = 0) -> None:
        links = table.links
        c, s = np.cos(table.alpha_rad), np.sin(table.alpha_rad)
        # Rows of A_j are linear in cos theta and sin theta: A = cos * even + sin * odd + constant.
        even, odd = np.zeros((links, 4, 4)), np.zeros((links, 4, 4))
        constant = np.zeros((links, 4, 4))
        even[:, 0, 0], even[:, 0, 3] = 1.0, table.a_m
        even[:, 1, 1], even[:, 1, 2] = c, -s
        odd[:, 0, 1], odd[:, 0, 2] = -c, s
        odd[:, 1, 0], odd[:, 1, 3] = 1.0, table.a_m
        constant[:, 2, 1], constant[:, 2, 2], constant[:, 2, 3] = s, c, table.s_m
        constant[:, 3, 3] = 1.0
        twisted = np.zeros((links, 4, 4))
        twisted[:, 1, 1] = twisted[:, 3, 3] = 1.0
        twisted[:, 0, 0] = twisted[:, 2, 2] = np.cos(table.beta_rad)
        twisted[:, 0, 2], twisted[:, 2, 0] = np.sin(table.beta_rad), -np.sin(table.beta_rad)
        even, odd, constant = even @ twisted, odd @ twisted, constant @ twisted
        self._even, self._odd, self._constant = even, odd, constant
        self._links = np.empty((links, 4, 4))
        self._frames = np.empty((links + 1, 4, 4))
        self._frames[0] = np.eye(4)
        frames = self._frames
        self._products = list(zip(frames[:-1], self._links, frames[1:], strict=True))
        self.axes_z = self._frames[:, :3, 2]
        self.base_axes = self._frames[1, :3, :3]
        self.origins_m = self._frames[:, :3, 3]
        self.error = np.zeros(components)
        self.jacobian = np.zeros((components, links))
        # Axis and origin of every joint, (2, x y z x y, n + 1): a cross product is two products of slices.
        self._joints = np.empty((2, 5, links))
        self._axes_and_origins = self._frames[:-1, :3, 2:].transpose(2, 1, 0)
        self._lever = np.empty((5, links))

    def at(self, theta_rad: FloatArray) -> FloatArray:
        """Evaluate at true angles theta_0, theta'_1 .. theta'_n, shape (n + 1,), rad; return the last frame (4, 4)."""
        cosine, sine = np.cos(theta_rad), np.sin(theta_rad)
        np.multiply(self._even, cosine[:, None, None], out=self._links)
        self._links += self._odd * sine[:, None, None]
        self._links += self._constant
        dot = np.dot
        for before, link, after in self._products:
            dot(before, link, after)
        end: FloatArray = self._frames[-1]
        return end

    def _point_jacobian(self, p: FloatArray, rows: FloatArray) -> None:
        """Write the derivative of a point `p` (3,) of the last link into `rows` (3, n + 1)."""
        joints, lever = self._joints, self._lever
        joints[:, :3] = self._axes_and_origins
        joints[:, 3:] = joints[:, :2]
        np.subtract(p[_CYCLIC, None], joints[1], out=lever)
        z = joints[0]
        np.multiply(z[1:4], lever[2:], out=rows)
        rows -= z[2:] * lever[1:4]


class LoopPoint(ChainPoint):
    """Chain with frame n constrained to frame -1; the error is a rotation vector (rad), then a position (m).

    If `hinge` is false, theta_0 must stay 0.
    """

    def __init__(self, table: DhTable, *, hinge: bool = True) -> None:
        super().__init__(table, 6)
        self._hinge = hinge

    def at(self, theta_rad: FloatArray) -> FloatArray:
        """Evaluate frames, error and Jacobian as `ChainPoint.at` does."""
        end = super().at(theta_rad)
        r0, r1, r2 = _rotation_vector(end[:3, :3].tolist())
        p = end[:3, 3]
        self.error[:] = (r0, r1, r2, *p.tolist())
        J = self.jacobian
        self._point_jacobian(p, J[3:])
        # dr = E w with E = 1 - [r]/2 + f [r]^2 (solver.chain.rotations.rotation_vector_differential).
        square = r0 * r0 + r1 * r1 + r2 * r2
        f = _second_order_factor(math.sqrt(square))
        diagonal = 1.0 - f * square
        E = np.array(
            (
                (diagonal + f * r0 * r0, 0.5 * r2 + f * r0 * r1, -0.5 * r1 + f * r0 * r2),
                (-0.5 * r2 + f * r0 * r1, diagonal + f * r1 * r1, 0.5 * r0 + f * r1 * r2),
                (0.5 * r1 + f * r0 * r2, -0.5 * r0 + f * r1 * r2, diagonal + f * r2 * r2),
            )
        )
        J[:3] = E @ self.axes_z[:-1].T
        if not self._hinge:
            J[:, 0] = 0.0
        return end


class BallPoint(ChainPoint):
    """Chain with point `tip_m` (3,) of the last link held at `ground_m` (3,) of the base; error: ball minus socket, m.

    Frame -1 is the base: row 0 of the table is zero, and theta_0 stays zero.
    """

    def __init__(self, table: DhTable, *, tip_m: FloatArray, ground_m: FloatArray) -> None:
        super().__init__(table, 3)
        self._tip, self._ground = tip_m, ground_m

    def at(self, theta_rad: FloatArray) -> FloatArray:
        """Evaluate frames, error and Jacobian as `ChainPoint.at` does."""
        end = super().at(theta_rad)
        ball = end[:3, :3] @ self._tip + end[:3, 3]
        self.error[:] = ball - self._ground
        self._point_jacobian(ball, self.jacobian)
        self.jacobian[:, 0] = 0.0
        return end


def _rotation_vector(R: list[list[float]]) -> tuple[float, float, float]:
    """Return the rotation vector of a matrix, rad; the angle must be well below half a turn."""
    (r00, r01, r02), (r10, r11, r12), (r20, r21, r22) = R
    x, y, z = r21 - r12, r02 - r20, r10 - r01
    # 4 w^2 = 1 + trace; the quaternion's vector part is (x, y, z) / 4w.
    four_w2 = 1.0 + r00 + r11 + r22
    if four_w2 < 1e-3:
        raise ValueError("the loop is open by half a turn, which no fixture allows")
    w = 0.5 * math.sqrt(four_w2)
    x, y, z = x / (4.0 * w), y / (4.0 * w), z / (4.0 * w)
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if sine < 1e-150 else 2.0 * math.atan2(sine, w) / sine
    return x * scale, y * scale, z * scale


def _second_order_factor(angle: float) -> float:
    """Return ``(1 - (angle/2) cot(angle/2)) / angle^2``, whose series starts 1/12 + angle^2/720."""
    if angle < 1e-4:
        return 1.0 / 12.0 + angle * angle / 720.0
    half = 0.5 * angle
    return (1.0 - half / math.tan(half)) / (angle * angle)
