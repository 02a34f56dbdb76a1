"""Information of a pose about the parameters, for thousands of candidate poses at once.

A closed pose adds ``A' V^-1 A`` to the Fisher information, in the estimators' linearisation (method, section 3). `A`
also has columns for the effects of stated errors (lengths, twists, encoders, play, sag, compliance). A thousand similar
poses determine these effects no better than one pose does (method, section 10).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray
from solver.design.d_optimal import summed_information
from solver.errors import PosesDoNotFitError
from solver.estimators.effects import Linearisation, LinearModel, State
from solver.estimators.error_model import ErrorModel
from solver.loops.closure import ClosureModel

EFFECTS = 40
"""Number of combinations of effects used in planning. The combinations that the poses determine best are used: on the
built-in arms they carry 99.9 % of the information, and a choice among 3,000 poses takes one second."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseInformation:
    """Square roots of the information of m poses about P parameters and K effects.

    `parameters`: names, in column order. `root` (m, r, P + K): ``L^-1 [A, Z]`` with ``V = L L'``; a pose's information
    is ``root' root``. The last K columns are effects, with a standard normal prior.
    """

    parameters: tuple[str, ...]
    root: FloatArray

    def of(self, poses: Sequence[int]) -> FloatArray:
        """Information of a set of poses (P + K, P + K); a pose listed twice counts twice."""
        return summed_information(self.root, poses)

    def about(self, parameters: Sequence[str]) -> PoseInformation:
        """Return the information about `parameters` and the effects; the other parameters count as known."""
        columns = [self.parameters.index(name) for name in parameters]
        columns += range(len(self.parameters), self.root.shape[-1])
        return replace(self, parameters=tuple(parameters), root=self.root[..., columns])


def pose_information(
    model: ClosureModel,
    x: FloatArray,
    q: FloatArray,
    closed_q: FloatArray,
    closed_u: FloatArray,
    errors: ErrorModel,
    variances: Mapping[str, float] | None = None,
) -> PoseInformation:
    """Return each pose's information about the parameters of `model` without a tolerance, for the errors `errors`.

    Raises `ValueError` if a closure component has no noise at all (exact joints and a stiff fixture).

    `x`: parameters (P + T,) of `model`, T of them toleranced. `q`: readings (m, n) of captured or planned poses.
    `closed_q`, `closed_u`: closed poses at `x` nearest to the readings: (m, n), (m, U). `variances`: those of the
    error model's components, by name; None: as stated.
    """
    design = LinearModel(model, q, errors)
    equations = Linearisation(
        design, State(x=x, e=closed_q - q, u=closed_u, closed_q=closed_q, closed_u=closed_u)
    )
    sizes = design.start_variances() if variances is None else design.variances_by_name(variances)
    root = np.sqrt(design.group_variances(sizes))
    try:
        parts = [
            design.whiten(equations.at_poses(part), sizes, root, part) for part in design.parts()
        ]
    except PosesDoNotFitError as error:
        raise ValueError(
            "some closure components have no noise, because their joints have none"
        ) from error
    columns = np.concatenate([p.M for p in parts])
    effects = columns[..., design.hard :]
    # Leading combinations of independent effects are independent effects again.
    rows = np.concatenate(list(effects))
    _, turn = np.linalg.eigh(rows.T @ rows)
    leading = effects @ turn[:, : -EFFECTS - 1 : -1]
    return PoseInformation(
        parameters=tuple(model.parameters[k].name for k in design.hard_index),
        root=np.concatenate((columns[..., : design.hard], leading), axis=-1),
    )
