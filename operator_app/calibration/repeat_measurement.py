"""A pose measured twice: whether something slipped in between, and by how much.

The drives do not return exactly, and the other joints follow the drives. The resulting difference between the readings
lies along the self-motions of the chain. Any other difference is noise, play, compliance of the fixture, or a slip.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fixtures.base import Compliance
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.sensors import NoSensor
from solver.closing import close_loops
from solver.design.motion import chain_motion
from solver.loops.closure import ClosureModel

if TYPE_CHECKING:
    from operator_app.calibration.experiment import Experiment

SMALLEST_DEFLECTION_RAD, SMALLEST_DEFLECTION_M = 1e-4, 1e-4
"""Rotation and displacement that scale a slip of a fixture whose stated compliance is zero."""

SLIP_SIZES = np.geomspace(1.0, 1e4, 200)
"""Multiples of the stated compliance at which a slip of the fixture is tried."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatedReading:
    """Two readings of one pose; `label`: its label, `after`: number of poses captured before the second reading.

    `first_rad` (n,): mean of `samples` samples. `again_rad` (n,): mean of the second reading's `samples_again` samples.
    """

    label: str
    after: int
    first_rad: FloatArray
    again_rad: FloatArray
    samples: int
    samples_again: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeat:
    """Comparison of the two readings `read` of one pose.

    `difference_rad` (n,): second reading minus the first, all joints.
    `chi2`, `dof`: test of the part of the difference that no motion of the chain explains, under stated errors.
    `joint`: joint (1-based) whose slip would explain most of this chi2.
    `size_rad`, `sigma_rad`: most likely slip of this joint, and its standard uncertainty.
    `turned_rad`, `shifted_m`: most likely rotation and displacement of the fixture, if it slipped instead.
    `joint_odds`: likelihood of the joint's slip divided by that of the fixture's slip, each at its most likely size.
    """

    read: RepeatedReading
    difference_rad: FloatArray
    chi2: float
    dof: int
    joint: int
    size_rad: float
    sigma_rad: float
    joint_odds: float
    turned_rad: float
    shifted_m: float


def compare_readings(
    arm: ArmModel, model: ClosureModel, x: FloatArray, read: RepeatedReading, compliance: Compliance
) -> Repeat | None:
    """Compare two readings of one pose; None if motions of the chain could explain every possible difference.

    `model`, `x`: the loop of this pose and its calibrated parameters, which determine the motions of the chain.
    `compliance`: stated compliance of the fixture, whose deflection may differ between the readings due to friction.
    """
    used, variances = [], []
    for j, joint in enumerate(arm.joints):
        if not isinstance(joint.sensor, NoSensor) and j + 1 not in model.unsensed_joints:
            # Noise of two readings, and play that may be taken up from either side. Sag under gravity is the same in
            # the same pose.
            used.append(j)
            variances.append(
                joint.sensor.variance_of_mean_rad2(read.samples)
                + joint.sensor.variance_of_mean_rad2(read.samples_again)
                + 2.0 * joint.backlash_rad**2
            )
    sigma = np.sqrt(variances)
    closed = close_loops(model, x, np.asarray(read.first_rad)[None])
    motion = chain_motion(model, x, closed.q, closed.u)
    error = model.loop(x, closed.q, closed.u)
    J = np.concatenate((error.jac_q[0], error.jac_u[0]), axis=-1)
    difference = np.asarray(read.again_rad - read.first_rad)
    # If the fixture is displaced by f, J dq = f. Solutions dq differ by motions, which `open_directions` omits.
    basis = np.linalg.qr(motion.tangent[0, used] / sigma[:, None], mode="complete")[0]
    open_directions = basis[:, motion.degrees :]
    if not open_directions.size:
        return None
    d: FloatArray = open_directions.T @ (difference[used] / sigma)
    by_give = open_directions.T @ (np.linalg.pinv(J)[used] / sigma[:, None])
    stated = np.repeat([compliance.orientation_rad, compliance.position_m], 3)
    least = np.repeat([SMALLEST_DEFLECTION_RAD, SMALLEST_DEFLECTION_M], 3)
    # Without rotations in the closure error, only the displacement counts.
    stated, least = (sizes[6 - by_give.shape[1] :] for sizes in (stated, least))
    bends = by_give * stated
    # Whitened by all stated errors: unit variance of the noise, and two draws of the compliance.
    L = np.linalg.cholesky(np.eye(len(d)) + 2.0 * bends @ bends.T)
    d = np.asarray(np.linalg.solve(L, d), dtype=np.float64)
    by_joint = np.linalg.solve(L, open_directions.T)
    size = np.maximum((by_joint**2).sum(0), 1e-12)
    by_joint_d = by_joint.T @ d
    explained = by_joint_d**2 / size
    k = int(np.argmax(explained))
    chi2, gained = float(d @ d), float(explained[k])
    # Gain in log-likelihood from a step change of the joint's reading, at the step's most likely variance.
    of_joint = 0.5 * (gained - 1.0 - float(np.log(gained))) if gained > 1.0 else 0.0
    shape = np.where(stated > 0.0, stated, least)
    gain, slip = _of_fixture(d, np.asarray(np.linalg.solve(L, by_give * shape), dtype=np.float64))
    slip = slip * shape
    return Repeat(
        read=read,
        difference_rad=difference,
        chi2=chi2,
        dof=len(d),
        joint=used[k] + 1,
        size_rad=float(by_joint_d[k] / size[k] * sigma[k]),
        sigma_rad=float(sigma[k] / np.sqrt(size[k])),
        joint_odds=float(np.exp(np.clip(of_joint - gain, -300.0, 300.0))),
        turned_rad=float(np.linalg.norm(slip[:-3])),
        shifted_m=float(np.linalg.norm(slip[-3:])),
    )


def _of_fixture(d: FloatArray, columns: FloatArray) -> tuple[float, FloatArray]:
    """Fit a slip of the fixture; return the gain in log-likelihood, and the k components of the most likely slip (k,).

    `d` (r,): difference of two readings, whitened to unit variance. `columns` (r, k): change of `d` per unit slip.
    """
    values, vectors = np.linalg.eigh(columns @ columns.T)
    along = vectors.T @ d
    spread = 1.0 + SLIP_SIZES[:, None] ** 2 * np.maximum(values, 0.0)
    gain = 0.5 * (along**2 * (1.0 - 1.0 / spread) - np.log(spread)).sum(-1)
    best = int(np.argmax(gain))
    slip = SLIP_SIZES[best] ** 2 * columns.T @ (vectors @ (along / spread[best]))
    return max(0.0, float(gain[best])), np.asarray(slip)


def repeats_of(
    rereads: Iterable[RepeatedReading], used: Experiment, model: ClosureModel, x: FloatArray
) -> tuple[Repeat, ...]:
    """Compare the two readings of each repeated pose in `used`; `model`, `x`: loops of `used` and their parameters.

    For an open arm the result is empty: without a loop, the drives alone may cause any difference.
    """
    if model.parts()[0][0].constrained_part is None:
        return ()
    labels, compliance = used.poses.label, used.fixture.compliance
    repeats = []
    for read in rereads:
        if read.label in labels:
            loop = model.at_poses(np.array([labels.index(read.label)]))
            repeats.append(compare_readings(used.arm, loop, x, read, compliance))
    return tuple(filter(None, repeats))
