"""Public logs of real arms with a ball in the hand (tests/data/real_arms), and a plain NumPy fit of them."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.oracles.loop_oracle import product
from tests.oracles.panda import panda_readings

FOLDER = Path(__file__).resolve().parents[1] / "data" / "real_arms"

BALL = """\
schema: sarcal/fixture/1
name: ball
kind: ball
placement: {{tip_mm: [0, 0, {tip_mm}], ground_mm: [400, 0, 100]}}
stays_on_hand: true
tolerance_mm: 30
tolerance_deg: 10
give: {{position_mm: 0.2}}
checklist: ["the ball turns freely in its socket"]
"""


@dataclass(frozen=True, kw_only=True)
class RealArm:
    """One set of logs: `urdf` is empty for the packaged `franka_panda`; `training` is the number of sockets to fit."""

    name: str
    urdf: str
    tip_mm: float
    training: int

    def readings(self) -> tuple[np.ndarray, np.ndarray]:
        """Placement (m,) and joint angles (m, n), rad, of all poses."""
        if self.name == "panda_1":
            return panda_readings()
        files = sorted((FOLDER / self.name).glob("*.csv"))
        logs = [np.loadtxt(f, delimiter=",") for f in files]
        return np.repeat(np.arange(1, len(logs) + 1), [len(q) for q in logs]), np.concatenate(logs)


SIGMA_M = 0.3e-3
"""Standard deviation of the ball's position in the fit."""

ARMS = (
    RealArm(name="panda_1", urdf="", tip_mm=130.0, training=2),
    RealArm(name="panda_6", urdf="", tip_mm=130.0, training=2),
    RealArm(name="kuka_14", urdf="iiwa14.urdf", tip_mm=0.0, training=2),
    RealArm(name="h_xarm6", urdf="h_xarm6.urdf", tip_mm=0.0, training=3),
)


def tips(rows: np.ndarray, tip: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Ball (m, 3) of D-H rows (n, 5): s, a, alpha, theta_off, beta."""
    s, a, alpha, theta_off, beta = rows.T
    return (product(q + theta_off, s, a, alpha, beta) @ np.append(tip, 1.0))[:, :3]


def script(
    rows: np.ndarray, tip: np.ndarray, q: np.ndarray, placement: np.ndarray, sd: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Fit of rows (n, 5) with priors `sd` and of the tip to one standard deviation of the ball about its sockets."""
    free, start = sd.ravel() > 0.0, np.concatenate((rows.ravel(), tip))
    free = np.concatenate((free, np.ones(3, dtype=bool)))
    size = np.concatenate((sd.ravel(), np.full(3, 0.1)))[free]

    def split(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = start.copy()
        values[free] = x
        return values[:-3].reshape(rows.shape), values[-3:]

    def residuals(x: np.ndarray) -> np.ndarray:
        ball = tips(*split(x), q)
        sockets = [ball[placement == k] for k in set(placement)]
        deviation = np.concatenate([socket - socket.mean(0) for socket in sockets])
        return np.concatenate((deviation.ravel() / SIGMA_M, (x - start[free]) / size))

    x = start[free]
    for _ in range(8):
        r = residuals(x)
        J = np.stack([(residuals(x + h) - r) / 1e-6 for h in 1e-6 * np.eye(len(x))], axis=1)
        x = x - np.linalg.lstsq(J, r, rcond=None)[0]
    return split(x)
