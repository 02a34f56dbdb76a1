"""The implicit fit by ODRPACK: orthogonal distance regression on the oracle's closure."""

import numpy as np
import odrpack

from tests.oracles.loop_oracle import Truth, _stepped, product

PENALTY_SCALE = 1e9
"""ODRPACK closes implicit models by a penalty; this scale leaves an error of 1e-10 sigma."""


def hinge_equations(truth: Truth, q: np.ndarray) -> np.ndarray:
    """Five equations a pose, (m, 5), independent of the hinge angle: R13, R23 and p after rotation (eq. 13)."""
    T = product(
        np.concatenate((np.zeros_like(q[..., :1]), q), axis=-1) + truth.theta_off,
        truth.s,
        truth.a,
        truth.alpha,
    )
    x, n, p = T[..., :3, 0], T[..., :3, 2], T[..., :3, 3]
    length = np.sqrt(x[..., 0] ** 2 + x[..., 1] ** 2)
    c, s = x[..., 0] / length, x[..., 1] / length
    rows = (
        c * n[..., 0] + s * n[..., 1],
        c * n[..., 1] - s * n[..., 0],
        c * p[..., 0] + s * p[..., 1],
        c * p[..., 1] - s * p[..., 0],
        p[..., 2],
    )
    return np.stack(rows, axis=-1)


def fit(
    start: Truth, q: np.ndarray, sigma: np.ndarray, names, scale: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Parameters (P,) and joint corrections (m, n) of the readings `q`, from `start`.

    `scale` (P,) is the size of a step in each parameter, for conditioning only.
    """
    start_values = start.values(names)
    h = 1e-40

    def truth_at(beta):
        return start.with_values(names, start_values + beta * scale)

    def equations(x, beta):
        return PENALTY_SCALE * hinge_equations(truth_at(beta), x.T * sigma).T

    def rates(points, widths):
        """Derivatives (5, k, m) at (truth, readings) with complex steps, per unit of `widths` (k,)."""
        columns = [
            hinge_equations(*at).imag.T * (w / h) for at, w in zip(points, widths, strict=True)
        ]
        return PENALTY_SCALE * np.stack(columns, axis=1)

    def by_parameter(x, beta):
        truth = truth_at(beta)
        return rates([(_stepped(truth, n, h), x.T * sigma) for n in names], scale)

    def by_reading(x, beta):
        truth = truth_at(beta)
        return rates([(truth, x.T * sigma + 1j * h * row) for row in np.eye(len(sigma))], sigma)

    result = odrpack.odr_fit(
        equations,
        np.ascontiguousarray((q / sigma).T),
        np.zeros((5, len(q))),
        np.zeros(len(names)),
        task="implicit-ODR",
        jac_beta=by_parameter,
        jac_x=by_reading,
        scale_beta=np.ones(len(names)),
        scale_delta=np.ones(len(sigma)),
        partol=1e-14,
        sstol=1e-14,
        maxit=300,
    )
    return start_values + result.beta * scale, result.delta.T * sigma
