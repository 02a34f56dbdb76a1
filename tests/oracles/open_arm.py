"""Poses of the paper's arm with its hand measured by an instrument; shares no code with `solver`."""

from pathlib import Path

import numpy as np

from tests.oracles.loop_oracle import paper_truth, product

BASE_POSE = np.array(
    [[0.36, -0.80, 0.48, 1.2], [0.93, 0.28, -0.224, -0.3], [0.0448, 0.527, 0.8486, 0.5]]
)
TIP_M = np.array([0.04, -0.03, 0.11])


def write_measured_poses(
    path: Path,
    *,
    poses: int = 40,
    sigma_m: float = 5e-5,
    wrong_rad: dict[int, float] | None = None,
    longer_m: dict[int, float] | None = None,
) -> Path:
    """Write readings and measured points; `wrong_rad` and `longer_m` change the arm's offsets and lengths."""
    truth, rng = paper_truth(), np.random.default_rng(11)
    U, _, Vt = np.linalg.svd(BASE_POSE[:, :3])
    R = U @ Vt if np.linalg.det(U @ Vt) > 0 else U @ np.diag([1.0, 1.0, -1.0]) @ Vt
    spread = np.deg2rad([60, 60, 60, 60, 60, 45, 45])
    q = truth.home + spread * rng.uniform(-1.0, 1.0, (poses, 7))
    theta_off, s = truth.theta_off[1:].copy(), truth.s[1:].copy()
    for joint, offset in (wrong_rad or {}).items():
        theta_off[joint - 1] += offset
    for row, offset in (longer_m or {}).items():
        s[row - 1] += offset
    hand = product(q + theta_off, s, truth.a[1:], truth.alpha[1:])
    point = (hand @ np.append(TIP_M, 1.0))[:, :3]
    measured = point @ R.T + BASE_POSE[:, 3] + sigma_m * rng.standard_normal((poses, 3))
    names = [f"theta{j}_deg" for j in range(1, 8)]
    lines = [",".join(["placement", "pose", *names, "x_m", "y_m", "z_m"])]
    for k in range(poses):
        row = [*np.rad2deg(q[k]).tolist(), *measured[k].tolist()]
        lines.append(",".join(["1", str(k + 1), *(repr(v) for v in row)]))
    path.write_text("\n".join(lines) + "\n")
    return path
