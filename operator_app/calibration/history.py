"""History of one arm's accepted calibrations and verifications: scatter, shifts, next due date.

The caller reads the files. Offsets of the arm itself are tested over all sessions, parameters of the mounting only
over the sessions of the last mounting. Each combination of fixture and estimator has a separate history, because it
has different systematic errors.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import pairwise
from statistics import median

import numpy as np

from operator_app.calibration.comparison import Side, nearest_values, sides_of
from operator_app.config.parameters_file import ParametersDocument
from solver.arrays import FloatArray
from solver.chain.parameters import DhEntry, DhKind, wrap_angle
from solver.diagnostics.control_chart import BASELINE, ControlChart, control_chart, smallest_shift

ONE_DAY, ONCE_A_YEAR = timedelta(days=1), timedelta(days=365)
"""Shortest time between two calibrations that counts as an interval, and the interval used if there is none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PastCalibration:
    """One accepted calibration of a session; `within`: type A uncertainty of its entries (rad, m), by name.

    Sessions between which the fixture stayed mounted have the same number `mounting`.
    """

    session: str
    document: ParametersDocument
    within: Mapping[str, float]
    mounting: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PastVerification:
    """A verification with new poses: time, number of poses, whether it passed, rms closure (m)."""

    session: str
    utc: datetime
    poses: int
    holds: bool
    position_m: float
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class EntryHistory:
    """History of the entries that describe one part, from calibrations with one fixture and one estimator.

    `side`: the part, i.e. arm, fixture on the table or fixture on the tool. `calibrations`: oldest first.
    `values` (sessions, entries), rad and m: in each session, the equivalent values nearest to the first session's.
    `sigma` (sessions, entries): standard uncertainty of `values`. `within` (sessions, entries): type A part of `sigma`.
    `chart`: control limits of each session, and the shifts of entries in the order in which they were detected.
    `smallest`: smallest shift of each entry that three more sessions detect in 90 % of cases; NaN with few sessions.
    """

    side: Side
    calibrations: tuple[PastCalibration, ...]
    names: tuple[str, ...]
    values: FloatArray
    sigma: FloatArray
    within: FloatArray
    chart: ControlChart
    smallest: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmHistory:
    """Calibrations and verifications of one arm over time.

    `parts`: for each fixture and estimator, histories of the arm's offsets and of the last mounting's parameters.
    `left_out`: sessions not used, each with the reason. `due`: date of the next calibration. `due_why`: its reason.
    """

    calibrations: tuple[PastCalibration, ...]
    verifications: tuple[PastVerification, ...]
    parts: tuple[EntryHistory, ...]
    left_out: tuple[tuple[str, str], ...]
    due: datetime
    due_why: str

    @property
    def shifted(self) -> bool:
        """Whether any entry has shifted."""
        return any(part.chart.changes for part in self.parts)


def history_of(
    calibrations: Sequence[PastCalibration],
    verifications: Sequence[PastVerification],
    *,
    left_out: Sequence[tuple[str, str]] = (),
    interval: timedelta | None = None,
) -> ArmHistory:
    """Order the accepted calibrations of one arm (at least one) by time, and test each against those before it."""
    ordered = sorted(calibrations, key=lambda c: c.document.utc)
    accepted: list[PastCalibration] = []
    skipped = list(left_out)
    poses: dict[str, str] = {}
    for past in ordered:
        # The same poses again are not a new measurement.
        earlier = poses.setdefault(past.document.pose_set_sha256, past.session)
        if earlier == past.session:
            accepted.append(past)
        else:
            skipped.append((past.session, f"the same poses as {earlier}"))
    methods: dict[tuple[object, ...], list[PastCalibration]] = {}
    for past in accepted:
        d = past.document
        methods.setdefault((d.fixture, d.estimator, len(d.joints)), []).append(past)
    parts = []
    for group in methods.values():
        parts.append(_part(group, Side.ARM))
        last = [c for c in group if c.mounting == group[-1].mounting]
        parts += [_part(last, side) for side in (Side.GROUND, Side.HAND)]
    parts = [part for part in parts if part.names]
    checks = tuple(sorted(verifications, key=lambda v: v.utc))
    due, reason = _due(accepted, checks, parts, interval)
    return ArmHistory(
        calibrations=tuple(accepted),
        verifications=checks,
        parts=tuple(parts),
        left_out=tuple(skipped),
        due=due,
        due_why=reason,
    )


def _part(group: Sequence[PastCalibration], side: Side) -> EntryHistory:
    """Return the history of those entries of `side` that all calibrations of `group` have identified.

    Of the arm's entries, only offsets are included: estimates of lengths and twists mostly repeat the maker's values.
    """
    first = group[0].document
    sides = sides_of(first)
    common = set.intersection(*({e.entry for e in c.document.calibrated} for c in group))
    names = tuple(
        e.entry
        for e in first.calibrated
        if e.entry in common
        and sides[e.entry] is side
        and (side is not Side.ARM or DhEntry.parse(e.entry).kind is DhKind.THETA_OFF)
    )
    entries = [DhEntry.parse(name) for name in names]
    stacked = first.table.stacked()
    base = np.array([stacked[e.kind, e.row] for e in entries])
    angles = np.array([e.kind.is_angle for e in entries], dtype=np.bool_)
    values, sigma, within = (np.zeros((len(group), len(names))) for _ in range(3))
    for k, past in enumerate(group):
        nearest = nearest_values(first, past.document)
        change = np.array([nearest[name] for name in names]) - base
        values[k] = base + np.where(angles, wrap_angle(change), change)
        stated = {e.entry: e.sigma for e in past.document.calibrated}
        sigma[k] = [stated[name] for name in names] * np.where(angles, math.radians(1.0), 1.0)
        within[k] = [past.within.get(name, s) for name, s in zip(names, sigma[k], strict=True)]
    chart = control_chart(names, values, within)
    smallest = np.full(len(names), np.nan)
    if len(group) > BASELINE and names:
        smallest = smallest_shift(chart.between[-1], len(group), len(names))
    return EntryHistory(
        side=side,
        calibrations=tuple(group),
        names=names,
        values=values,
        sigma=sigma,
        within=within,
        chart=chart,
        smallest=smallest,
    )


def _due(
    accepted: Sequence[PastCalibration],
    checks: Sequence[PastVerification],
    parts: Sequence[EntryHistory],
    interval: timedelta | None,
) -> tuple[datetime, str]:
    """Return when and why the next calibration is due.

    If a verification failed since the last calibration, the verification's date is returned. If the last calibration
    detected a shift, its date is returned. Otherwise, the date is one interval after the last calibration.
    """
    last = accepted[-1].document.utc
    if failed := [v for v in checks if v.utc > last and not v.holds]:
        return failed[-1].utc, f"the verification of {failed[-1].utc:%Y-%m-%d} did not hold"
    for part in parts:
        for shift in part.chart.changes:
            if part.calibrations[shift.detected_at].session == accepted[-1].session:
                return last, f"{shift.name} has shifted: a second calibration confirms it"
    if interval is not None:
        days = f"{interval.days} day{'s' if interval.days != 1 else ''}"
        return last + interval, f"{days} after the last, as stated"
    times = [c.document.utc for c in accepted]
    # Several calibrations on one day define no interval.
    gaps = [b - a for a, b in pairwise(times) if b - a >= ONE_DAY]
    if not gaps:
        return last + ONCE_A_YEAR, "a year after the last; state an interval with --every"
    usual = timedelta(seconds=median(gap.total_seconds() for gap in gaps))
    return last + usual, "the usual interval after the last (median)"
