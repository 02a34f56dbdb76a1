"""Several placements of a fixture in one data set: one arm, and unknowns of the fixture for each placement.

The arm's parameters are shared; those of the fixture carry the placement's number: ``ground_x[2]``. With a single
placement names have no number. If the fixture's half on the tool is the same in all placements, e.g. one ball for
several sockets, the unknowns of this half are shared as well (`same_hand`).

With a hinge, theta_off_1 and s_1 are measured from the common normal of the hinge axis and joint 1's axis, theta_off_n
to the common normal of joint n's axis and the hinge axis. So these entries count as unknowns of the fixture, with names
like ``theta_off_1[2]`` (`ClosureModel.ground_side`, `hand_side`). No information is lost: an error of joint 1's zero
rotates all placements about joint 1's axis, which no closed loop can show.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solver.arrays import FloatArray, IntArray
from solver.chain.parameters import DhEntry, Parameter
from solver.chain.poses import back_to_caller
from solver.loops.closure import ClosureModel, LoopError, ReducedError

MAX_COMBINATIONS = 4096


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placements(ClosureModel):
    """The loops of all placements as a single `ClosureModel`, which knows the placement of each pose.

    `numbers`: the operator's numbers of the placements, ascending. `placement` (m,): number of each pose's placement.
    `models`: loop of each placement. All loops have the same arm and the same kind of fixture.
    `same_hand`: whether the fixture's half on the tool is the same in all placements.
    `parameters`: shared unknowns first, then each placement's own unknowns, with the placement's number in the name.
    """

    numbers: tuple[int, ...]
    models: tuple[ClosureModel, ...]
    placement: IntArray
    same_hand: bool
    # Computed once, since estimators need them at every step.
    joint_count: int = field(init=False, repr=False)
    unsensed_joints: tuple[int, ...] = field(init=False, repr=False)
    components: int = field(init=False, repr=False)
    equations_per_pose: int = field(init=False, repr=False)
    parameters: tuple[Parameter, ...] = field(init=False, repr=False)
    _columns: tuple[IntArray, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("joint_count", "unsensed_joints", "components", "equations_per_pose"):
            object.__setattr__(self, name, getattr(self.models[0], name))
        object.__setattr__(self, "parameters", self._listed())
        names = [p.name for p in self.parameters]
        columns = tuple(
            np.array([names.index(self._name(p.name, number)) for p in model.parameters])
            for number, model in zip(self.numbers, self.models, strict=True)
        )
        object.__setattr__(self, "_columns", columns)

    def columns(self, number: int) -> IntArray:
        """Return the indices of the parameters of placement `number` in the vector of all parameters."""
        return self._columns[self.numbers.index(number)]

    def of(self, number: int) -> tuple[ClosureModel, IntArray]:
        """Model of placement `number`, and indices of its parameters among all; `ValueError` for an unknown number."""
        return self.models[self.numbers.index(number)], self.columns(number)

    def parts(self) -> tuple[tuple[ClosureModel, IntArray, IntArray], ...]:
        """Model, indices of its parameters and indices of its poses, for every placement that has poses."""
        return tuple(
            (model, self.columns(number), poses)
            for number, model in zip(self.numbers, self.models, strict=True)
            if len(poses := np.flatnonzero(self.placement == number))
        )

    def loop(self, x: FloatArray, q: FloatArray, u: FloatArray) -> LoopError:
        """Closure error of every pose in its own placement."""
        errors = [model.loop(*own) for model, own in self._each(x, q, u)]
        return LoopError(**self._gathered(errors, residual=1, jac_x=2, jac_q=2, jac_u=2))

    def initial_unsensed(self, x: FloatArray, q: FloatArray) -> FloatArray:
        """Initial unsensed angles of every pose (..., m, U), rad."""
        angles = [model.initial_unsensed(*own) for model, own in self._each(x, q)]
        return self._in_order(angles, 1)

    def reduced(self, x: FloatArray, q: FloatArray, *, rates: bool = True) -> ReducedError:
        """Return the closure error of every pose in its own placement, with the hinge angle eliminated."""
        return self.merged([model.reduced(*own, rates=rates) for model, own in self._each(x, q)])

    def merged(self, errors: Sequence[ReducedError]) -> ReducedError:
        """Join the reduced errors of all `parts` in the order of the poses."""
        return replace(errors[0], **self._gathered(errors, residual=1, jac_x=2, flipped=0))

    def _each(
        self, x: FloatArray, *angles: FloatArray
    ) -> Iterator[tuple[ClosureModel, list[FloatArray]]]:
        """Yield the loop of each placement that has poses, with its part of `x` and of each of `angles` (..., m, n)."""
        if (count := angles[0].shape[-2]) != len(self.placement):
            raise ValueError(f"{count} poses for a model bound to {len(self.placement)}")
        for model, columns, poses in self.parts():
            yield model, [np.asarray(x)[..., columns], *(a[..., poses, :] for a in angles)]

    def _gathered(
        self, errors: Sequence[LoopError | ReducedError], **trailing: int
    ) -> dict[str, Any]:
        """Join the placements' errors field by field; `trailing`: number of axes after the pose axis of each field."""
        arrays = {name: [getattr(e, name) for e in errors] for name in trailing}
        if arrays["jac_x"][0].shape[-1]:
            # From each placement's parameters to all parameters.
            for k, (_, columns, _) in enumerate(self.parts()):
                own = arrays["jac_x"][k]
                arrays["jac_x"][k] = np.zeros((*own.shape[:-1], len(self.parameters)))
                arrays["jac_x"][k][..., columns] = own
        return {name: self._in_order(arrays[name], axes) for name, axes in trailing.items()}

    def _in_order(self, arrays: Sequence[NDArray[Any]], trailing: int) -> NDArray[Any]:
        """Join the placements' `arrays` in the order of the poses; `trailing`: number of axes after the pose axis."""
        order, axis = np.concatenate([poses for *_, poses in self.parts()]), -1 - trailing
        return np.take(np.concatenate(arrays, axis=axis), back_to_caller(order), axis=axis)

    def equivalents(self, x: FloatArray) -> FloatArray:
        """Return all parameter vectors (E, P) that describe the same loops as `x` (P,).

        Each vector combines one equivalent vector of each placement. The placements agree on the unknowns that they
        share. If there are more than `MAX_COMBINATIONS` combinations, only those are listed that differ from the first
        in a single placement.
        """
        x = np.asarray(x, dtype=np.float64)
        shared = self._shared
        # Equivalent vectors of each placement, sorted by their values of the shared entries.
        choices: list[dict[tuple[float, ...], list[FloatArray]]] = []
        for number, model in zip(self.numbers, self.models, strict=True):
            is_shared = [p.name in shared for p in model.parameters]
            table: dict[tuple[float, ...], list[FloatArray]] = {}
            for y in model.equivalents(x[self.columns(number)]):
                table.setdefault(tuple(y[is_shared].tolist()), []).append(y)
            choices.append(table)
        vectors = []
        for signature in choices[0]:
            if not all(signature in table for table in choices):
                continue
            lists = [table[signature] for table in choices]
            combinations = (
                list(product(*lists))
                if prod(map(len, lists)) <= MAX_COMBINATIONS
                else [
                    (*(first[0] for first in lists[:k]), y, *(first[0] for first in lists[k + 1 :]))
                    for k in range(len(lists))
                    for y in lists[k]
                ]
            )
            for combination in combinations:
                z = x.copy()
                for number, y in zip(self.numbers, combination, strict=True):
                    z[self.columns(number)] = y
                vectors.append(z)
        return np.stack(vectors)

    def with_all_joints_sensed(self) -> Placements:
        """Return the same loops with the readings of all joints used; offsets of unsensed joints become unknowns."""
        return replace(self, models=tuple(m.with_all_joints_sensed() for m in self.models))

    @property
    def ground_side(self) -> tuple[str, ...]:
        """Names of the unknowns that locate the fixture on the table, in all placements."""
        return self._side("ground_side")

    @property
    def hand_side(self) -> tuple[str, ...]:
        """Names of the unknowns that locate the fixture on the tool, in all placements."""
        return self._side("hand_side")

    def without(self, names: Collection[str]) -> Placements:
        """Return the same loops with the named unknowns fixed at their nominal values."""
        models = [
            model.without({p.name for p in model.parameters if self._name(p.name, number) in names})
            for number, model in zip(self.numbers, self.models, strict=True)
        ]
        return replace(self, models=tuple(models))

    def freed(self, entries: Sequence[DhEntry]) -> Placements:
        """Return the same loops with `entries` of the arm's table as additional unknowns."""
        return replace(self, models=tuple(model.freed(entries) for model in self.models))

    def at_poses(self, poses: IntArray) -> Placements:
        """Return the model for the poses `poses`; placements without poses keep their unknowns."""
        poses = np.arange(len(self.placement))[poses]
        taken_here = (self.placement == number for number in self.numbers)
        models = tuple(
            model.at_poses(np.searchsorted(np.flatnonzero(here), poses[here[poses]]))
            for model, here in zip(self.models, taken_here, strict=True)
        )
        return replace(self, models=models, placement=self.placement[poses])

    @property
    def _shared(self) -> tuple[str, ...]:
        model = self.models[0]
        own = set(model.ground_side) | (set() if self.same_hand else set(model.hand_side))
        return tuple(p.name for p in model.parameters if p.name not in own)

    def _name(self, name: str, number: int) -> str:
        if len(self.numbers) == 1 or name in self._shared:
            return name
        return f"{name}[{number}]"

    def _listed(self) -> tuple[Parameter, ...]:
        if len(self.numbers) == 1:
            return self.models[0].parameters
        shared = self._shared
        listed = [p for p in self.models[0].parameters if p.name in shared]
        for number, model in zip(self.numbers, self.models, strict=True):
            own = [p for p in model.parameters if p.name not in shared]
            listed += [replace(p, name=self._name(p.name, number)) for p in own]
        return tuple(listed)

    def _side(self, side: str) -> tuple[str, ...]:
        names = [
            self._name(name, number)
            for number, model in zip(self.numbers, self.models, strict=True)
            for name in getattr(model, side)
        ]
        return tuple(dict.fromkeys(names))


def place(model: ClosureModel, placement: IntArray, *, same_hand: bool = False) -> Placements:
    """Return the loops of all placements of a fixture; `placement` (m,): number of the placement of each pose.

    `model`: loop of one placement; its nominal values are used for all. A `MeasuredClosure` must have measurements of
    all poses, in order. `same_hand`: whether the fixture's half on the tool is the same in all placements.
    """
    numbers = tuple(np.unique(placement).tolist())
    models = tuple(model.at_poses(np.flatnonzero(placement == k)) for k in numbers)
    return Placements(numbers=numbers, models=models, placement=placement, same_hand=same_hand)
