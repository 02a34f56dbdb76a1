"""One pose read twice: which joint's reading slipped in between, and by how much? Knows no session.

A session comes back to its first pose. The drives do not return exactly, and the others follow them:
such a difference lies along the chain's own motions. What is left is noise, or something slipped.
Says what the readings say; what follows from it is the verdict's affair.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.sensors import NoSensor
from solver.closing import close_loops
from solver.design.motion import chain_motion
from solver.loops.closure import ClosureModel


@dataclass(frozen=True, slots=True, kw_only=True)
class Repeat:
    """What two readings of one pose say.

    Attributes
    ----------
    difference_rad
        (n,) second reading less the first, all joints.
    chi2, dof
        Of the difference that no motion of the chain explains, by the stated noise.
    joint
        The joint (1-based) whose reading alone explains most of that.
    size_rad, sigma_rad
        By how much it slipped then, and how well that is known.
    chi2_left
        What stays unexplained by it, with one degree of freedom less: large where it was no joint,
        but the fixture.
    """

    difference_rad: FloatArray
    chi2: float
    dof: int
    joint: int
    size_rad: float
    sigma_rad: float
    chi2_left: float


def compare_readings(
    arm: ArmModel,
    model: ClosureModel,
    x: FloatArray,
    first_rad: FloatArray,
    again_rad: FloatArray,
    *,
    samples: int,
) -> Repeat:
    """Compare two readings (n,) of one pose, each the mean of `samples`, by stated noise and play.

    Parameters
    ----------
    model, x
        The loop and its parameters as calibrated: they say how the chain moves.
    """
    used, sigmas = [], []
    for j, joint in enumerate(arm.joints):
        if not isinstance(joint.sensor, NoSensor) and j + 1 not in model.unsensed_joints:
            # Noise of two readings, and play that may be taken up from either side.
            variance = joint.sensor.variance_of_mean_rad2(samples) + joint.backlash_rad**2
            used.append(j)
            sigmas.append(np.sqrt(2.0 * variance))
    sigma = np.array(sigmas)
    closed = close_loops(model, x, np.asarray(first_rad)[None])
    motion = chain_motion(model, x, closed.q, closed.u).tangent[0, used]
    difference = np.asarray(again_rad - first_rad)
    d = difference[used] / sigma
    # Off the motions, each joint's own slip is a column of what is left.
    Q = np.linalg.qr(motion / sigma[:, None])[0]
    off = np.eye(len(used)) - Q @ Q.T
    left = off @ d
    seen = np.maximum(np.diagonal(off), 1e-12)
    explained = left**2 / seen
    k = int(np.argmax(explained))
    chi2 = float(left @ left)
    return Repeat(
        difference_rad=difference,
        chi2=chi2,
        dof=len(used) - Q.shape[1],
        joint=used[k] + 1,
        size_rad=float(left[k] / seen[k] * sigma[k]),
        sigma_rad=float(sigma[k] / np.sqrt(seen[k])),
        chi2_left=chi2 - float(explained[k]),
    )
