"""Lists the effects of a loop with stated errors, and the variance components that groups of effects share.

An effect is an error that repeats from pose to pose; it has a column and a coefficient. Every source of error that the
files state has a group of columns, a variance component, or both. `solver.estimators.effects` calculates the columns.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from solver.arrays import BoolArray, FloatArray, IntArray
from solver.chain.parameters import Parameter, nominal_vector
from solver.chain.sensors import LOWEST
from solver.estimators.error_model import ErrorModel
from solver.estimators.load_effects import UNMODELLED_SHARE
from solver.estimators.shapes import PoseBasis, Shapes, pose_process, shapes_of_sag, sides_of_play
from solver.loops.closure import ClosureModel

LEAST_NOISE_SHARE = 1e-3
"""Smallest standard deviation of an analogue reading, as a share of the stated standard deviation."""

SMALLEST_DEFLECTION = 1e-8
"""Smallest deflection (rad, m) of a fixture, also assumed if the fixture is stated to be rigid."""

LARGEST_PLACEMENT_SCALE = 100.0
"""Largest distance of a fixture from its stated place, in units of the stated tolerance."""

SMALLEST_SCALE = 0.03
"""Smallest estimated scale of a source of error (1: as stated); a smaller scale has no effect on an estimate."""

LEAST_CURVE = 0.1
"""Smallest linearity deviation of an analogue sensor, as a share of its specification."""

SPECIFICATION_DOF = 4
"""Weight of a sensor's specification of linearity or gain, as degrees of freedom of an estimate of the variance. It is
needed because poses determine only a few coefficients of the deviation, too few for a reliable variance."""

DEFLECTION_RAISE_LIMIT = 5e-4
"""One step of the search may raise the deflection to this (rad, m). If the misfit is large, the search starts here."""

LARGEST_SCALE = 10.0
"""Largest errors of lengths, twists and encoders, play and sag, in units of the stated errors. Larger errors are a
fault, which the tests diagnose: without bounds, a fit of many poses would explain any fault by these errors."""

LARGEST_DISCREPANCY = 5.0
"""Largest discrepancy that is estimated, in units of `UNIT_DISCREPANCY`; a larger one is diagnosed as a fault."""

UNIT_DISCREPANCY = 1e-3
"""Unit of the discrepancy: 1 mm and 1 mrad."""

NON_REPEATABLE_SHARE = 0.4
"""Standard deviation of the part of deflection or play that does not repeat at the same pose, as a share of the stated
value. The part that repeats has the whole stated value. Each part has a scale of its own, because the poses determine
the scale of the first part well and that of the second poorly."""

UNMODELLED = "unmodelled"
"""Variance component of the part of sag and deflection that the effects' columns omit. This part is modelled as noise.
It is at most as large as stated, and estimated from the scatter of the poses."""

LEAST_UNMODELLED = 0.1
"""Lower limit of `UNMODELLED` (1: as stated): a part that is smooth in the pose scatters less than its size."""

FIXTURE_NOISE = ("fixture_rad", "fixture_m")
"""Components of the part of a fixture's deflection that does not repeat: rotation, translation."""

DEFLECTION_COLUMNS = 12
"""Number of smooth functions of the pose for the fixture's deflection in one placement."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VarianceComponent:
    """One variance v to be estimated. With the default fields, v is the ratio of a source's variance to the stated one.

    `start`: value at which the search starts. `stated`: value that the files state.
    `floor`, `ceiling`: limits of v. `raise_limit`: one step may always raise v to this value.
    `scaled`: whether v has a log-normal prior with median `start` (method, section 10): v stays near `start` unless the
    poses determine it.
    `prior_scale`: if finite, v has a prior density proportional to exp(-v / (2 prior_scale)).
    `spread_variance`, `spread_dof`: an estimate of v from the spread of the samples within each pose or from a
    specification, and the degrees of freedom of this estimate.
    """

    name: str
    start: float = 1.0
    floor: float = SMALLEST_SCALE**2
    stated: float = 1.0
    scaled: bool = True
    prior_scale: float = np.inf
    ceiling: float = LARGEST_SCALE**2
    raise_limit: float = 0.0
    spread_variance: float = 0.0
    spread_dof: int = 0

    @property
    def source(self) -> str:
        """Name of this source of error in an uncertainty budget."""
        kind, _, which = self.name.partition("_")
        if kind in _OF_RVDTS:
            return f"rvdt_{_OF_RVDTS[kind]}_{which}"
        return _SOURCES.get(self.name, self.name)


_OF_RVDTS = {"rvdt": "noise", "curve": "curve", "gain": "gain"}
"""Sources of error of an RVDT, by the first part of the component's name."""

_SOURCES = {
    **dict.fromkeys((*FIXTURE_NOISE, "compliance", "smooth_give"), "fixture_give"),
    "play_sides": "joint_play",
}
"""Name of the source, for components that share their source with other components."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Group:
    """Columns whose coefficients share one variance.

    `source`: name of the group in an uncertainty budget. `names`: names of the columns.
    `fixed`, `rates`: the variance is `fixed` plus ``factor * v[index]`` for each pair (index, factor) in `rates`.
    """

    source: str
    names: tuple[str, ...]
    rates: tuple[tuple[int, float], ...] = ()
    fixed: float = 0.0

    def variance(self, v: FloatArray) -> float:
        """Return the variance that each column's coefficient has for variance components `v` (K,)."""
        return self.fixed + sum(rate * float(v[c]) for c, rate in self.rates)


class Layout:
    """Columns of the parameters and effects of a closure model with stated errors, and their K variance components.

    `q` (m, n): readings, rad. `like`: a layout of the same poses; its smooth functions of the pose are used again.
    `width`: number of columns. The first `flat_count` columns belong to parameters with a flat prior: nothing is known
    of them beforehand. The other columns belong to effects; a parameter with a tolerance counts as an effect.
    `column` (P,): column of each parameter. `index`: index of each component by name.
    `floors`, `ceilings`, `raise_limits`, `scaled` (K,): values of these fields of all `VarianceComponent`s.
    `test_floors` (K,): smallest variances of noise with which single readings are tested.
    `expected` (m, n): expected sum of play and sag, rad. `deflection` (k,): the fixture's stated deflection, rad, m.
    `loaded`: effects of load on the fixture; None if unknown or zero.
    """

    def __init__(
        self,
        model: ClosureModel,
        q: FloatArray,
        errors: ErrorModel,
        *,
        group: IntArray | None = None,
        like: Layout | None = None,
    ) -> None:
        self.model, self.q, self.errors, self.group = model, q, errors, group
        parameters = model.parameters
        names = [p.name for p in parameters]
        known = {**errors.prior, **errors.tolerance}
        for name, sd in known.items():
            if name not in names:
                raise ValueError(f"{name} has a tolerance and is not a free parameter")
            if not sd > 0.0:
                raise ValueError(f"the tolerance of {name} must be positive")
        for joint in (a.joint for a in errors.analogue):
            if not 1 <= joint <= model.joint_count or joint in model.unsensed_joints:
                raise ValueError(f"no reading of joint {joint} is used, so its noise is unknown")
        self.nominal = nominal_vector(parameters)
        self.has_prior: BoolArray = np.array([n in known for n in names], dtype=bool)
        # Ordered as lengths, twists, offsets, placement, so that each kind is one group of columns.
        fixture = {*model.ground_side, *model.hand_side}
        self.prior_kind = np.array(
            [PRIOR_KINDS.index(_source(p, fixture)) for p in parameters], dtype=int
        )
        self.prior_index = np.concatenate(
            [
                np.flatnonzero(self.has_prior & (self.prior_kind == k))
                for k in range(len(PRIOR_KINDS))
            ]
        )
        self.prior_sd = np.array([known[names[k]] for k in self.prior_index])
        self.flat_index = np.flatnonzero(~self.has_prior)
        self.column = np.argsort(np.concatenate((self.flat_index, self.prior_index)))
        read = ~np.isin(np.arange(1, model.joint_count + 1), model.unsensed_joints)
        self.rows = model.components
        self.accuracy, self.backlash, self.sag = (
            np.zeros(model.joint_count) if values is None else np.where(read, values, 0.0)
            for values in (errors.accuracy_rad, errors.backlash_rad, errors.sag_rad)
        )
        sizes = list(zip(FIXTURE_NOISE, (errors.give_rad, errors.give_m), strict=True))
        self.stated_deflection = {k: s for k, s in sizes[self.rows != 6 :] if s is not None}
        turn_rad, shift_m = (self.stated_deflection.get(key, 0.0) for key in FIXTURE_NOISE)
        blocks = [(slice(self.rows - 3, self.rows), shift_m), (slice(0, 3), turn_rad)]
        # Rows of the closure components that deflect, and the stated deflection along them.
        self.deflecting_rows = [
            (rows, stated)
            for rows, stated in blocks[: self.rows // 3]
            if stated > 0.0 or errors.discrepancy
        ]
        self.deflection = np.repeat((turn_rad, shift_m), (self.rows - 3, 3))
        deflects = self.deflection.any() and errors.loads and errors.loads.all_deflections.any()
        self.loaded = errors.loads if deflects else None
        self.components: list[VarianceComponent] = []
        self.groups: list[Group] = []
        self.deflection_basis: PoseBasis = (
            self._smooth_functions() if like is None else like.deflection_basis
        )
        self.play, self.sags = self.play_and_sag(q, errors)
        self.expected = self.play.expected + self.sags.expected
        self._lay_out(names)
        self.index = {c.name: k for k, c in enumerate(self.components)}
        self.floors = np.array([c.floor for c in self.components])
        self.ceilings = np.array([c.ceiling for c in self.components])
        self.raise_limits = np.array([c.raise_limit for c in self.components])
        # Single readings are not tested with less noise than expected, since their errors have tails.
        self.test_floors = np.array([c.start if c.scaled else c.floor for c in self.components])
        self.scaled = np.array([c.scaled for c in self.components], dtype=bool)
        self.flat_count = len(self.flat_index)
        wide = [len(g.names) for g in self.groups]
        ends = np.cumsum([self.flat_count, *wide])
        self.slices = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self.width = int(ends[-1])
        self._fixed = np.repeat([g.fixed for g in self.groups], wide)
        # Rates of every effect column's variance with the components (f, K).
        rates = np.zeros((len(wide), len(self.components)))
        for row, g in zip(rates, self.groups, strict=True):
            for c, rate in g.rates:
                row[c] = rate
        self.variance_rates = np.repeat(rates, wide, axis=0)

    def _smooth_functions(self) -> PoseBasis:
        if not self.deflecting_rows:
            return PoseBasis(phi=np.zeros((0, 0)), missed=np.zeros(0))
        groups = 1 if self.group is None else len(np.unique(self.group))
        group = None if groups == 1 else self.group
        return pose_process(self.q, DEFLECTION_COLUMNS * groups, group=group)

    def _component(self, component: VarianceComponent) -> int:
        self.components.append(component)
        return len(self.components) - 1

    def _group(self, source: str, names: Iterable[str], component: VarianceComponent) -> None:
        rates = ((self._component(component), 1.0),)
        self.groups.append(Group(source=source, names=tuple(names), rates=rates))

    def _lay_out(self, names: list[str]) -> None:
        self._lay_out_noise()
        for k, source in enumerate(PRIOR_KINDS):
            listed = tuple(names[i] for i in self.prior_index if self.prior_kind[i] == k)
            if listed and source == OFFSETS:
                # These parameters are to be identified: their prior uncertainty is stated, not estimated.
                self.groups.append(Group(source=source, names=listed, fixed=1.0))
            elif listed and source == PLACEMENT:
                # The fixture's distance from its nominal placement implies nothing about the arm.
                far = LARGEST_PLACEMENT_SCALE**2
                placement = VarianceComponent(name=source, floor=1.0, ceiling=far, raise_limit=far)
                self._group(source, listed, placement)
            elif listed:
                self._group(source, listed, VarianceComponent(name=source))
        turning = np.flatnonzero(self.accuracy)
        if len(turning):
            waves = ("sin", "cos", "sin2", "cos2")
            names = [f"{wave}_{j + 1}" for j in turning for wave in waves]
            self._group("encoder_accuracy", names, VarianceComponent(name="encoder_accuracy"))
        self._lay_out_curves()
        self._lay_out_joints()
        self._lay_out_deflection()

    def _lay_out_noise(self) -> None:
        for a in self.errors.analogue:
            self._component(
                VarianceComponent(
                    name=f"rvdt_{a.joint}",
                    start=a.variance,
                    floor=LEAST_NOISE_SHARE**2 * a.variance,
                    stated=a.variance,
                    scaled=False,
                    ceiling=np.inf,
                    spread_variance=a.spread_variance,
                    spread_dof=a.spread_dof,
                )
            )
        for key, stated in self.stated_deflection.items():
            start = NON_REPEATABLE_SHARE * stated
            self._component(
                VarianceComponent(
                    name=key,
                    start=max(start, SMALLEST_DEFLECTION) ** 2,
                    floor=max(SMALLEST_SCALE * start, SMALLEST_DEFLECTION) ** 2,
                    stated=max(stated, SMALLEST_DEFLECTION) ** 2,
                    scaled=stated > SMALLEST_DEFLECTION,
                    ceiling=np.inf,
                    raise_limit=DEFLECTION_RAISE_LIMIT**2,
                )
            )
        if self.backlash.any():
            start = NON_REPEATABLE_SHARE
            self._component(
                VarianceComponent(
                    name="joint_play", start=start**2, floor=(SMALLEST_SCALE * start) ** 2
                )
            )
        deflects = any(stated > 0.0 for _, stated in self.deflecting_rows)
        if len(self.sags.joints) or deflects or self.loaded is not None:
            self._component(VarianceComponent(name=UNMODELLED, floor=LEAST_UNMODELLED, ceiling=1.0))

    def _lay_out_curves(self) -> None:
        for a in self.errors.analogue:
            if a.curve is not None and a.curve.lines:
                gain = VarianceComponent(
                    name=f"gain_{a.joint}",
                    ceiling=np.inf,
                    spread_variance=1.0,
                    spread_dof=SPECIFICATION_DOF,
                )
                self._group(f"rvdt_gain_{a.joint}", [gain.name], gain)
            if a.curve is not None and a.curve.bent:
                bend = VarianceComponent(
                    name=f"curve_{a.joint}",
                    start=a.curve_variance,
                    floor=LEAST_CURVE**2 * a.curve_variance,
                    stated=a.curve_variance,
                    scaled=False,
                    ceiling=25.0 * a.curve_variance,
                    spread_variance=a.curve_variance,
                    spread_dof=SPECIFICATION_DOF,
                )
                names = [f"curve{k}_{a.joint}" for k in range(LOWEST, LOWEST + a.curve.bends)]
                self._group(f"rvdt_curve_{a.joint}", names, bend)

    def _lay_out_joints(self) -> None:
        if len(self.play.joints):
            # Play taken up to the same side in every pose is not noise but looks like an offset.
            sides = ("play", "approach")[: self.play.width]
            names = [f"{side}_{j + 1}" for j in self.play.joints for side in sides]
            self._group("joint_play", names, VarianceComponent(name="play_sides"))
        if len(self.sags.joints):
            names = [f"sag{i}_{j + 1}" for j in self.sags.joints for i in range(self.sags.width)]
            self._group("sag", names, VarianceComponent(name="sag"))

    def play_and_sag(self, q: FloatArray, errors: ErrorModel) -> tuple[Shapes, Shapes]:
        """Return the effects of play and of sag at readings `q` (m, n), rad, with the loads in `errors`."""
        return (
            sides_of_play(q, errors, self.backlash),
            shapes_of_sag(q, errors, self.sag),
        )

    def _lay_out_deflection(self) -> None:
        """Add the columns for the part of the fixture's deflection that repeats at the same pose or load."""
        # The basis has a variance of 2: a constant and a linear part in addition to its scales.
        self.free_deflection = 1.0 if self.loaded is None else 0.5 * UNMODELLED_SHARE
        discrepancies: tuple[tuple[int, float], ...] = ()
        if self.errors.discrepancy:
            discrepancy = VarianceComponent(
                name="discrepancy",
                start=1e-8,
                floor=1e-8,
                stated=1e-8,
                scaled=False,
                prior_scale=1.0,
                ceiling=LARGEST_DISCREPANCY**2,
                raise_limit=0.04,
            )
            discrepancies = ((self._component(discrepancy), UNIT_DISCREPANCY**2),)
        smooth = None
        if any(stated > 0.0 for _, stated in self.deflecting_rows):
            smooth = self._component(VarianceComponent(name="smooth_give"))
        functions = range(self.deflection_basis.phi.shape[1])
        for rows, stated in self.deflecting_rows:
            rates = discrepancies
            if smooth is not None and stated > 0.0:
                rates = (*rates, (smooth, self.free_deflection * stated**2))
            names = [f"give{i}_{row}" for row in range(rows.start, rows.stop) for i in functions]
            self.groups.append(
                Group(source="fixture_give", names=tuple(names), rates=rates, fixed=1e-18)
            )
        if self.loaded is not None:
            names = [f"load{i}" for i in range(self.loaded.all_deflections.shape[-1])]
            self._group("fixture_give", names, VarianceComponent(name="compliance"))

    @property
    def motion_components(self) -> list[int]:
        """Indices of the components that scale the noise of deflection, play and sag."""
        moving = (*FIXTURE_NOISE, "joint_play", UNMODELLED)
        return [k for name, k in self.index.items() if name in moving]

    @property
    def noise_components(self) -> list[int]:
        """Indices of all components that scale noise: one for each analogue sensor, then `motion_components`."""
        return [*range(len(self.errors.analogue)), *self.motion_components]

    def start_variances(self) -> FloatArray:
        """Return the start values (K,) of the variance components."""
        return np.array([c.start for c in self.components])

    def stated_variances(self) -> FloatArray:
        """Return the variances (K,) that the files state.

        For the noise of deflection and of play, this is the whole stated variance, although a part of it repeats.
        """
        return np.array([c.stated for c in self.components])

    def variances_by_name(self, named: Mapping[str, float]) -> FloatArray:
        """Return all variances (K,), clipped to their bounds: those in `named`, and start values for the others."""
        v = np.array([named.get(c.name, c.start) for c in self.components])
        return np.asarray(np.clip(v, self.floors, self.ceilings))

    def as_stated(self, v: FloatArray) -> FloatArray:
        """Return the stated variances (K,); for the fixture's placement the one in `v` (K,) if that is larger."""
        stated = self.stated_variances()
        if (k := self.index.get(PLACEMENT)) is not None:
            stated[k] = max(stated[k], v[k])
        return stated

    def group_variances(self, v: FloatArray) -> FloatArray:
        """Return the variance of each of f effects' coefficients (f,), for variance components `v` (K,)."""
        return np.asarray(self._fixed + self.variance_rates @ v)


LENGTHS, TWISTS, OFFSETS, PLACEMENT = "lengths", "twists", "offsets", "placement"
PRIOR_KINDS = (LENGTHS, TWISTS, OFFSETS, PLACEMENT)
"""Kinds of parameters with a prior, in the order of the parameters' columns."""


def _source(parameter: Parameter, fixture: Collection[str]) -> str:
    """Return a parameter's kind: `LENGTHS`, `TWISTS`, `OFFSETS` or `PLACEMENT`. `fixture`: the fixture's parameters."""
    if parameter.name.startswith("theta_off_"):
        return OFFSETS
    if parameter.name in fixture:
        return PLACEMENT
    return TWISTS if parameter.is_angle else LENGTHS
