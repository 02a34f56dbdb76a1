"""The calibrated arm without its loop: tool position, its uncertainty, and offsets that were fixed.

Parameters of the mounting (`ground_side`, `hand_side`) change with the fixture; the arm's own parameters do not.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from operator_app.calibration.error_model import freed
from operator_app.calibration.result import Solution
from operator_app.calibration.tool_accuracy import HandAccuracy, HeldOffset, spread_along, spread_of
from solver.arrays import FloatArray, even_points, evenly
from solver.chain.arm_model import ArmModel
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhEntry, DhKind, is_entry
from solver.chain.sensors import NoSensor
from solver.closing import reduced_equations
from solver.estimators.estimate import closure_at_readings
from solver.estimators.linear_fit import LinearFit
from solver.estimators.variance_components import Calibrated
from solver.loops.closure import ClosureModel, ClosureSigmas, in_order
from solver.loops.endpoints import TIP, MeasuredClosure, PointClosure
from solver.posterior.best_table import BestTable, best_table, tool_positions, where_used
from solver.posterior.corrections import Corrections, JointCorrections, corrections_of

Frame = Literal["tip", "flange"]

TIP_NAMES = frozenset(TIP)

NEWTON_STEPS = 3
"""Number of Newton steps to an unknown placement; for a ball, the closure is linear in the socket's coordinates."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibratedArm:
    """Links 1..n of a calibrated arm, and the tip: the point of its tool that the fixture holds.

    The base frame is that of the arm's file: entries that locate the fixture in the laboratory keep the file's values.

    `flange`: D-H rows 1..n with the arm's own entries as calibrated, and the other entries as in the arm's file.
    `hand`: D-H rows 1..n with the arm's own entries, and those that locate the fixture on the tool, as calibrated.
    `tip_m`: the tip in the last frame of `hand`, (3,), m: the ball's centre or the instrument's target. It is zero for
    a rigid attachment and for a hinge (the hinge's axis is the z axis of that frame).
    `identified`: names of the calibrated entries of `flange`.
    `free`: names of the calibrated entries of `hand` and of the calibrated tip coordinates.
    `best`: best D-H table for uncorrected readings. `corrections`: corrections of the readings. Both may be None.
    """

    flange: DhTable
    hand: DhTable
    tip_m: FloatArray
    identified: tuple[str, ...]
    free: tuple[str, ...]
    _covariance: FloatArray
    best: BestTable | None = None
    corrections: Corrections | None = None

    def table(self, frame: Frame = "flange") -> DhTable:
        """Return D-H rows 1..n for uncorrected readings; the last row ends in the flange or in the tip's frame."""
        if self.best is None:
            return self.flange if frame == "flange" else self.hand
        if frame == "tip":
            return self.best.table
        # Entries of the last link that the fixture determines are not the arm's own.
        return _with_last_link(self.best.rows, self.flange.stacked(), reference=self.hand.stacked())

    @property
    def table_tip_m(self) -> FloatArray:
        """Position of the tip (3,), m, in the last frame of the D-H rows that ``table("tip")`` returns."""
        return self.tip_m if self.best is None else self.best.tip_m

    def T_base(
        self, q_rad: FloatArray, frame: Frame = "tip", *, corrected: bool = False
    ) -> FloatArray:
        """Return the pose (..., 4, 4), m, of the tip or of the flange (frame n) in the base, at readings (..., n).

        The pose follows from `table` at the uncorrected readings. If `corrected`, it follows from the identified
        entries at readings to which `corrections` are added. The tip has the orientation of the last frame.
        """
        table, tip_m = self.table(frame), self.table_tip_m
        if corrected:
            table, tip_m = (self.hand if frame == "tip" else self.flange), self.tip_m
            q_rad = q_rad if self.corrections is None else q_rad + self.corrections.at(q_rad)
        T = T_base_flange(table, q_rad)
        if frame == "tip":
            T[..., :3, 3] += (T[..., :3, :3] @ tip_m[:, None])[..., 0]
        return T

    def tip_with_sigma_m(self, q_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the tip (m, 3) in the base frame, and the standard deviation (m,) of its error, both in metres.

        Both follow from `best` if it is not None (`BestTable.tool`). Otherwise, the standard deviation is
        ``sqrt(trace(J C J'))``: J holds the derivatives of the tip by the parameters `free`, and C is their covariance.
        """
        if self.best is not None:
            return self.best.tool(q_rad)
        tip, rates = self._rates(q_rad, self.free)
        return tip, np.sqrt(spread_along(rates, self._covariance))

    def stated_part_m(self, q_rad: FloatArray, names: Collection[str]) -> FloatArray:
        """Return the part of the tip's sigma, metres at m poses, due to parameters `names`; parts add in quadrature."""
        known = [k for k, name in enumerate(self.free) if name in names]
        if not known:
            return np.zeros(len(q_rad))
        C = self._covariance
        part = C[:, known] @ np.linalg.pinv(C[np.ix_(known, known)], hermitian=True) @ C[known]
        return np.sqrt(spread_along(self._rates(q_rad, self.free)[1], part))

    def rate_m_per_rad(self, joint: int, rates: dict[str, float], q_rad: FloatArray) -> FloatArray:
        """Return how far an error of a joint's fixed offset displaces the tip at m poses (m,), in metres per rad.

        `rates`: change of each fitted parameter per rad of this error, by name. If a parameter has a value for each
        placement, the rate of the last placement in `rates` is used. `q_rad` (m, n): readings of the poses.
        """
        plain = {name.partition("[")[0]: rate for name, rate in rates.items()}
        names = (DhEntry(DhKind.THETA_OFF, joint).name, *self.free)
        along = np.array([1.0, *(plain.get(name, 0.0) for name in self.free)])
        return np.asarray(np.linalg.norm(self._rates(q_rad, names)[1] @ along, axis=-1))

    def _rates(self, q_rad: FloatArray, names: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
        """Return tip positions (m, 3), in metres, at m poses, and their derivatives (m, 3, k) by the k parameters."""
        return tool_positions(self.hand, self.tip_m, names, q_rad)[:2]


def T_base_flange(table: DhTable, q_rad: FloatArray) -> FloatArray:
    """Pose (..., 4, 4), m, of the last frame of D-H rows 1..n in the base frame, at readings (..., n)."""
    frames = table.frames(q_rad)
    T = np.zeros((*np.shape(q_rad)[:-1], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = frames.R_end, frames.p_end, 1.0
    return T


MOST_POSES_SAMPLED = 100
"""Largest number of poses of a session, chosen evenly from all, for which a best table is computed."""

NOTEWORTHY_SHARE = 0.9
"""The part of the tool's sigma that is due to the poses, and not to parameters known from files, is reported only if it
is below this share of the total sigma."""

RANGE_SAMPLES = 300
"""Number of poses over the joints' ranges; the rms over them is accurate to about 4 %."""


def even_poses(arm: ArmModel) -> FloatArray:
    """Readings (m, n), rad, evenly spread over the ranges of all joints."""
    even = even_points(RANGE_SAMPLES, arm.joint_count)
    return np.asarray(arm.lower_rad + even * (arm.upper_rad - arm.lower_rad))


def hand_errors(
    calibrated: CalibratedArm, arm: ArmModel
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compare the tool position before and after calibration at m poses over the ranges of all joints.

    Returns, in metres, the calibrated tool position in the arm's base frame (m, 3), its distance from the position that
    the arm file gives (m,), and the standard deviation of its error (m,).
    """
    q = even_poses(arm)
    entries = (DhEntry.parse(name) for name in calibrated.identified)
    nominal = arm.table.stacked()
    nominal_arm = replace(
        calibrated,
        hand=with_entries(
            calibrated.hand, {e.name: float(nominal[e.kind, e.row - 1]) for e in entries}
        ),
        best=None,
    )
    tip, sigma = calibrated.tip_with_sigma_m(q)
    return tip, np.linalg.norm(tip - nominal_arm.T_base(q)[:, :3, 3], axis=-1), sigma


def side_of(model: ClosureModel, name: str) -> Literal["arm", "ground", "hand"]:
    """Return what an unknown describes: the arm, or the fixture on the table ("ground") or tool ("hand").

    Only the arm's parameters stay valid in another mounting.
    """
    part, plain = model.parts()[0][0], name.partition("[")[0]
    return "ground" if plain in part.ground_side else "hand" if plain in part.hand_side else "arm"


def last_placement(solution: Solution) -> tuple[ClosureModel, dict[str, int]]:
    """Return the loop of the last placement, and the index in the estimate of each of its parameters, by name."""
    part, columns, _ = solution.model.parts()[-1]
    index = np.arange(len(solution.estimate.x))[columns].tolist()
    return part, dict(zip([p.name for p in part.parameters], index, strict=True))


def calibrated_arm(solution: Solution, arm: ArmModel) -> CalibratedArm:
    """Return `arm`, the arm of an arm file, with the values that `solution` identified."""
    estimate = solution.estimate
    # If the fixture is remounted on the tool for every placement, the tool of the last placement counts.
    part, column = last_placement(solution)
    x = {name: float(estimate.x[k]) for name, k in column.items()}
    sensed = part.with_all_joints_sensed()
    ground, hand = set(sensed.ground_side), set(sensed.hand_side)
    measured = {
        name: offset
        for j, offset in (solution.unsensed_offsets or {}).items()
        if (name := DhEntry(DhKind.THETA_OFF, j).name) not in ground
    }
    x |= {name: offset.value_rad for name, offset in measured.items()}
    entries = [name for name in x if is_entry(name) and name not in ground]
    own = [name for name in entries if name not in hand]
    tip = np.zeros(3)
    if isinstance(part, PointClosure | MeasuredClosure):
        tip = np.array([x.get(name, v) for name, v in zip(TIP, part.tip_m, strict=True)])
    free = [*entries, *(n for n in column if n in TIP_NAMES)]
    known = [k for k, name in enumerate(free) if name in column]
    rows = [column[free[k]] for k in known]
    covariance = np.diag([measured[n].sigma_rad ** 2 if n in measured else 0.0 for n in free])
    covariance[np.ix_(known, known)] = estimate.covariance[np.ix_(rows, rows)]
    flange = with_entries(arm.table, {n: x[n] for n in own})
    # The fixture's entries of the last link, identified or not, are added to the calibrated rows.
    held = _with_last_link(flange.stacked(), part.arm_rows(), reference=arm.table.stacked())
    return CalibratedArm(
        flange=flange,
        hand=with_entries(held, {n: x[n] for n in entries}),
        tip_m=tip,
        identified=tuple(own),
        free=tuple(free),
        _covariance=covariance,
        best=solution.best,
        corrections=solution.corrections,
    )


def with_best_table(
    solution: Solution, arm: ArmModel, calibrated: Calibrated, q: FloatArray
) -> Solution:
    """Return `solution` with best table and corrections; `calibrated`: implicit fit to the readings `q` (m, n), rad."""
    own = calibrated_arm(solution, arm)
    part, column = last_placement(solution)
    index = np.array([column[name] for name in own.free], dtype=np.int64)
    joints = JointCorrections(fit=calibrated.linear)
    sampled = q[evenly(len(q), MOST_POSES_SAMPLED)]
    used, weight = where_used(sampled, arm.lower_rad, arm.upper_rad)
    parts = joints.at(used)
    best = best_table(
        own.hand,
        own.tip_m,
        joints,
        parts,
        weight,
        known=own.free,
        covariance=joints.with_parameters(index),
        hayati=arm.hayati_rows,
        fixed=part.ground_side,
        tip=bool(TIP_NAMES & set(column)),
    )
    solution = replace(
        solution, best=best, corrections=corrections_of(joints, parts.first(len(sampled)))
    )
    used_closure = closure_in_use(solution, arm, solution.model, solution.estimate.x, q)
    return replace(
        solution, with_best_table=used_closure.best_table, with_corrections=used_closure.corrected
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosureInUse:
    """Closure sigmas for both uses of a calibration in a controller; None if not computed.

    `best_table`: with the best D-H table and uncorrected readings.
    `corrected`: with the identified entries, and readings to which the corrections are added.
    """

    best_table: ClosureSigmas | None = None
    corrected: ClosureSigmas | None = None


def with_estimated_place(
    model: ClosureModel, x: FloatArray, q: FloatArray, unknown: Collection[str]
) -> FloatArray:
    """Return x (P,), rad and m, with the parameters `unknown` estimated from readings q (m, n) alone, without a prior.

    `unknown`: names of parameters of a fixture's or an instrument's placement.
    """
    columns = [k for k, p in enumerate(model.parameters) if p.name in unknown]
    x = x.copy()
    for _ in range(NEWTON_STEPS if columns else 0):
        reduced = reduced_equations(model.loop(x, q, model.initial_unsensed(x, q)))
        A = reduced.A[..., columns].reshape(-1, len(columns))
        x[columns] -= np.linalg.lstsq(A, reduced.w.reshape(-1), rcond=None)[0]
    return x


def closure_in_use(
    solution: Solution,
    arm: ArmModel,
    model: ClosureModel,
    x: FloatArray,
    q: FloatArray,
    unknown: Collection[str] = (),
) -> ClosureInUse:
    """Return the closure sigmas that a controller gets with the best D-H table, and with corrected readings.

    `model`, `x`: a loop of the calibrated arm and the values of its parameters (P,), rad and m. `q`: readings (m, n).
    `unknown`: names of parameters of an uncalibrated placement. They are estimated from `q`, for each use separately.
    """
    best, corrections = solution.best, solution.corrections
    if best is None or corrections is None:
        return ClosureInUse()
    own = calibrated_arm(solution, arm)
    change, tip = best.rows - own.hand.stacked(), best.tip_m - own.tip_m
    changes = dict(zip(TIP, tip.tolist(), strict=True))
    for name in best.entries:
        if is_entry(name):
            entry = DhEntry.parse(name)
            changes[name] = float(change[entry.kind, entry.row - 1])
    # The best table also changes entries that were not calibrated: they become parameters of the loop too.
    whole = freed(model, best.entries)
    at_best = in_order(whole, model, x)
    at_best += [changes.get(p.name.partition("[")[0], 0.0) for p in whole.parameters]
    at_best = with_estimated_place(whole, at_best, q, unknown)
    corrected_q = q + corrections.at(q)
    x = with_estimated_place(model, x, corrected_q, unknown)
    return ClosureInUse(
        best_table=closure_at_readings(whole, at_best, q).sigmas,
        corrected=closure_at_readings(model, x, corrected_q).sigmas,
    )


def _with_last_link(rows: FloatArray, other: FloatArray, *, reference: FloatArray) -> DhTable:
    """Return `rows` (5, n); entries of the last link in which `other` and `reference` differ are those of `other`."""
    rows, differ = rows.copy(), other[:, -1] != reference[:, -1]
    rows[differ, -1] = other[differ, -1]
    return DhTable.from_stacked(rows)


def with_entries(table: DhTable, values: Mapping[str, float]) -> DhTable:
    """Return the D-H rows with the entries in `values` (by name, rad or m) replaced."""
    rows = table.stacked()
    for name, value in values.items():
        entry = DhEntry.parse(name)
        rows[entry.kind, entry.row - 1] = value
    return DhTable.from_stacked(rows)


NEGLIGIBLE = 2e-3
"""An offset is neglected if its error displaces the tool by less than this, m/rad (0.03 mm per degree)."""


def offsets_not_sought(model: ClosureModel, arm: ArmModel) -> tuple[int, ...]:
    """Joints (1-based) whose readings are used but whose offset is not a parameter of the loop."""
    sought = {p.name.partition("[")[0] for p in model.parameters}
    return tuple(
        j
        for j, joint in enumerate(arm.joints, 1)
        if DhEntry(DhKind.THETA_OFF, j).name not in sought
        and j not in model.unsensed_joints
        and not isinstance(joint.sensor, NoSensor)
    )


def tool_accuracy(
    calibrated: CalibratedArm, arm: ArmModel, as_stated: Collection[str], fit: LinearFit
) -> HandAccuracy:
    """Summarise the tool position error before and after calibration over the ranges of all joints.

    If a file states the uncertainty of fixed offsets, `after` includes it; otherwise, `holds_for` names these offsets.
    `as_stated`: parameters known from the files rather than from the poses. `fit`: fit of the calibration.
    """
    (_, before_m, after_m), q = hand_errors(calibrated, arm), even_poses(arm)
    square, held, known = after_m**2, list[HeldOffset](), arm.offset_tolerance_rad
    by_poses = spread_of(
        np.sqrt(np.maximum(square - calibrated.stated_part_m(q, as_stated) ** 2, 0.0))
    )
    stated = [name for name in calibrated.free if name in as_stated]
    model, B = fit.design.model, fit.whole.B
    for j in offsets_not_sought(model, arm):
        # An error of this fixed offset shifts the other parameters.
        rates = fit.moved_by(B[..., [j - 1]])[:, 0].tolist()
        along = dict(zip([p.name for p in model.parameters], rates, strict=True))
        rate = calibrated.rate_m_per_rad(j, along, q)
        rms, name = spread_of(rate).rms, DhEntry(DhKind.THETA_OFF, j).name
        if known is not None:
            square = square + (known * rate) ** 2
            stated += [name] if rms > NEGLIGIBLE else []
        elif rms > NEGLIGIBLE:
            value = float(arm.table.theta_off_rad[j - 1])
            held.append(HeldOffset(name=name, value_rad=value, rate_m_per_rad=rms))
    after = spread_of(np.sqrt(square))
    noteworthy = not by_poses.rms > NOTEWORTHY_SHARE * after.rms
    return HandAccuracy(
        before=spread_of(before_m),
        after=after,
        poses=RANGE_SAMPLES,
        holds_for=tuple(held),
        stated=tuple(stated) if noteworthy else (),
        after_by_poses=by_poses if noteworthy else None,
    )
