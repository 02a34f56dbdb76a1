"""Tables of a calibration's quality: condition, accuracy, closure."""

import math
from collections.abc import Callable, Iterable, Iterator

from operator_app import units
from operator_app.calibration.cross_validation import Checks
from operator_app.calibration.result import Solution
from operator_app.calibration.tool_accuracy import Spread
from operator_app.messages.finding import fixed_briefly
from operator_app.report.table import Cell, Column, FactTable, Headline, figures, words
from operator_app.units import Figure, Key, Kind, names, plural, significant
from solver.diagnostics.cross_validation import FOLDS
from solver.loops.closure import ClosureSigmas

BAR_PER_DECADE, BAR_DECADES = 10, 4
"""Length of the bar of a condition number: 20 characters for 100, 40 for 10,000 or more."""
SMALL_STATED_CHI2 = 0.1
"""Below this chi2/dof at stated noise, errors are on average less than a third of what the files state."""
SMALLER_THAN_STATED = (
    f"chi2/dof at stated noise is below {SMALL_STATED_CHI2:g}: the files state errors that are on average more "
    "than three times as large as these poses show. Sigmas may be larger than necessary."
)


def determined_table(solution: Solution, headlines: Iterable[Headline]) -> FactTable:
    """Return the table of condition number, rank, chi2 and degrees of freedom; some are in `headlines`.

    Closure sigmas in `headlines` are left out. A note names the parameters in the least determined direction.
    """
    estimate, identifiability = solution.identified, solution.identifiability
    weakest = identifiability.weakest
    named = zip(weakest.parameters[:4], weakest.weights, strict=False)
    weights = ", ".join(f"{name} {significant(weight, 2)}" for name, weight in named)
    freedom = f"{plural(solution.model.equations_per_pose, 'equation')} per pose, minus parameters"
    convergence = "converged" if estimate.converged else "did not converge"
    if solution.adjudication.diverged and estimate.converged:
        convergence += ", but far from what the files state"

    rows: list[tuple[Cell, ...]] = [(h.name, h.figure, h.note) for h in headlines if not h.closure]
    plain = units.CONDITION(identifiability.condition_number, key=("condition_number",))
    rows.insert(1, ("condition number, 1 m : 1 rad", plain, ""))
    if (read := solution.condition_at_readings) is not None:
        figure = units.CONDITION(read, key=("scaled_condition_number_at_readings",))
        rows.insert(1, ("scaled, at the joints as read", figure, "as the paper took it"))
    if (stated := solution.adjudication.stated_chi2_per_dof) is not None:
        ratio = units.CHI2(stated, key=("stated_chi2_per_dof",))
        rows.append(("chi2/dof at stated noise", ratio, "1 or less if errors are as stated"))
    small = stated is not None and stated < SMALL_STATED_CHI2 and not solution.adjudication.diverged
    rows += [
        ("degrees of freedom", Figure(estimate.dof, places=0, key=("dof",)), freedom),
        ("iterations", Figure(estimate.iterations, places=0, key=("iterations",)), convergence),
    ]
    return FactTable(
        ident="determined",
        title="How well the poses determine the parameters (no unit)",
        columns=(*words("figure"), *figures("value"), *words("")),
        rows=tuple(rows),
        note=f"Weakest direction: {weights}." + (f" {SMALLER_THAN_STATED}" if small else ""),
    )


def trend_table(solution: Solution) -> FactTable | None:
    """Return the table of condition number by number of poses; None with fewer than two values."""
    trend = solution.identifiability.trend
    if len(trend) < 2:
        return None
    rows: list[tuple[Cell, ...]] = []
    for k, (poses, value) in enumerate(trend):
        decades = min(max(math.log10(value), 0.0), BAR_DECADES)
        count = Figure(poses, places=0, key=("condition_trend", k, 0))
        condition = units.CONDITION(value, key=("condition_trend", k, 1))
        rows.append((count, condition, "#" * round(decades * BAR_PER_DECADE)))
    return FactTable(
        ident="trend",
        title="Condition number by number of poses (no unit)",
        columns=(
            *figures("first poses", "scaled"),
            Column("log scale: ten # are a factor of ten", words=True, summary=True),
        ),
        rows=tuple(rows),
    )


def hand_table(solution: Solution) -> FactTable | None:
    """Return the table of the tool position uncertainty at the poses of the calibration; None if not computed."""
    hand = solution.hand
    if hand is None:
        return None
    rms = Figure(hand.rms, units.CLOSURE_LENGTH, key=("tip_sigma_mm", "rms"))
    worst = Figure(hand.worst, units.CLOSURE_LENGTH, key=("tip_sigma_mm", "worst"))
    return FactTable(
        ident="hand",
        title="Tool position uncertainty (one sigma)",
        columns=(*words("at the poses of this calibration"), *figures("sigma [mm]")),
        rows=(("rms", rms), ("worst pose", worst)),
        note="From the covariance of the parameters, in the arm's base frame; errors of the readings add to it.",
    )


def accuracy_table(solution: Solution) -> FactTable | None:
    """Return the table of tool position error over joint ranges, before and after calibration; None if not computed."""
    accuracy = solution.accuracy
    if accuracy is None:
        return None
    spreads = {"before": accuracy.before, "after": accuracy.after}
    note = (
        f"At {accuracy.poses} poses evenly over the ranges, obstacles ignored. Before: distance between the tool "
        "positions from the arm file and from the calibrated entries, in the arm's base frame, without entries of the "
        f"mounting. After: uncertainty with the {'identified' if solution.best is None else 'best'} D-H table, without "
        "corrections"
        f"{fixed_briefly(tuple(h.name for h in accuracy.holds_for))}."
    )
    by_poses = accuracy.after_by_poses or accuracy.after
    if by_poses.rms > accuracy.before.rms:
        note += " Before is a distance, after an uncertainty."
    if accuracy.after_by_poses is not None:
        spreads["after_by_poses"] = accuracy.after_by_poses
        note += (
            f" If as stated: without the uncertainty of {names(accuracy.stated)}, which the files state and these "
            "poses hardly determine."
        )
    titles = ("before", "after, one sigma", "if as stated")[: len(spreads)]

    def row(title: str, key: str, value_of: Callable[[Spread], float]) -> tuple[Cell, ...]:
        place = "hand_accuracy_mm"
        return title, *(
            Figure(value_of(spread), units.CLOSURE_LENGTH, key=(place, when, key))
            for when, spread in spreads.items()
        )

    return FactTable(
        ident="accuracy",
        title="Tool position error before and after calibration [mm]",
        columns=(*words("over the ranges of all joints"), *figures(*titles)),
        rows=(
            row("rms", "rms", lambda spread: spread.rms),
            row("95 % stay below", "p95", lambda spread: spread.most),
            row("worst pose", "worst", lambda spread: spread.worst),
        ),
        note=note,
    )


TRUE_ERROR = Kind(units.CLOSURE_LENGTH, digits=2)


def truth_table(solution: Solution) -> FactTable | None:
    """Return the table of a simulated arm's true calibration errors; None for a real arm."""
    truth = solution.truth
    if truth is None:
        return None
    inside = Figure(truth.inside_95, places=0, key=("truth", "inside_95"))
    of = Figure(truth.of, places=0, key=("truth", "of"))
    off_by = TRUE_ERROR(truth.tool_rms_m, key=("truth", "tool_mm_rms"))
    predicted = TRUE_ERROR(truth.predicted_rms_m, key=("truth", "predicted_mm_rms"))
    return FactTable(
        ident="truth",
        title="True errors, which are known only for a simulated arm",
        columns=(*words("this arm is simulated"), *figures("found", "of, predicted")),
        rows=(
            ("entries within their 95 % intervals", inside, of),
            ("tool off by, rms [mm]", off_by, predicted),
        ),
        note="The tool with the identified entries and exact readings, over the ranges of all joints.",
    )


def truth_in_words(solution: Solution) -> str:
    """Return a sentence with a simulated arm's true calibration errors, in place of a table; empty for a real arm."""
    truth = solution.truth
    if truth is None:
        return ""
    tool, predicted = TRUE_ERROR(truth.tool_rms_m), TRUE_ERROR(truth.predicted_rms_m)
    return (
        f"{truth.inside_95} of {truth.of} entries within their 95 % intervals; with exact readings, the tool is off by "
        f"{tool.with_unit} rms (predicted {predicted.shown}), over the ranges of all joints."
    )


CLOSURE_COLUMNS = (
    *words("parameters"),
    *figures("rms", "as printed", group="sigma_pos [mm]"),
    *figures("rms", "as printed", group="sigma_ori [mrad]"),
)
"""Columns of closure sigmas: "as printed" is the paper's formula taken literally, see `ResidualSigma`."""


def closure_table(solution: Solution, checks: Checks | None) -> FactTable:
    """Return the table of closure sigmas: before and after calibration, of both estimators, and at held-out poses."""
    estimate, beside = solution.identified, solution.beside
    rows = [
        closure_row("nominal, before", solution.before, key=("before",)),
        *rows_in_use(solution.with_best_table, solution.with_corrections),
        closure_row(f"{estimate.estimator} (chosen), after", estimate.sigmas, key=()),
    ]
    if beside is not None:
        rows.append(closure_row(f"{beside.estimator}, for comparison", beside.sigmas))
    kinds = ((f"{FOLDS} folds", "hold_out"), ("far block", "far_block"))
    held = () if checks is None else (checks.held_out, checks.far_block)
    for (name, key), closure in zip(kinds, held, strict=False):
        if closure is not None:
            place, inside, held_out = ("checks", key), closure.inside_sigmas, closure.sigmas
            rows += [
                closure_row(f"{name}, took part", inside, key=place, reading="inside"),
                closure_row(f"{name}, held out", held_out, key=place, reading="held_out"),
            ]
    return FactTable(
        ident="closure",
        title="Closure at the measured joints (eqs. 14 and 15)",
        columns=CLOSURE_COLUMNS,
        rows=tuple(rows),
        note=(
            ""
            if solution.with_best_table is None
            else "A controller uses the best table or corrected readings. The rows below these two use the "
            "identified entries without corrections."
        ),
    )


def rows_in_use(
    best_table: ClosureSigmas | None, corrected: ClosureSigmas | None, *, name: str = "{}, after"
) -> Iterator[tuple[Cell, ...]]:
    """Yield the row of closure sigmas with the best D-H table, and the row with corrected readings.

    A controller uses one or the other. If an argument is None, its row is left out. `name`: format of the rows' names.
    """
    if best_table is not None:
        yield closure_row(name.format("best table"), best_table, key=("with_best_table",))
    if corrected is not None:
        yield closure_row(name.format("corrected readings"), corrected, key=("with_corrections",))


def closure_row(
    name: str, sigmas: ClosureSigmas, *, key: Key | None = None, reading: str = ""
) -> tuple[Cell, ...]:
    """Return the row of closure sigmas called `name`.

    `key`: first part of the figures' keys in JSON; None leaves all figures out of JSON.
    `reading`: if not empty, JSON has the rms figures only, and the last part of their keys is `reading`, not ``rms``.
    """
    cells: list[Cell] = [name]
    turned = sigmas.orientation_rad
    if turned is not None and turned.rms == 0.0:
        # Journals of earlier versions have 0 if the loop has no rotation equations.
        turned = None
    for symbol, kind, both in (
        ("sigma_pos_mm", units.SIGMA_POS, sigmas.position_m),
        ("sigma_ori_mrad", units.SIGMA_ORI, turned),
    ):
        rms, printed = (None, None) if both is None else (both.rms, both.as_printed)
        for value, last in ((rms, reading or "rms"), (printed, "as_printed")):
            listed = key is not None and not (reading and last == "as_printed")
            place = (*key, symbol, last) if key is not None and listed else ()
            cells.append(kind(value, key=place))
    return tuple(cells)


def causes_table(solution: Solution) -> FactTable | None:
    """Return the table of possible faults, the main one first; None if there are none. Only HTML describes them."""
    rows: list[tuple[Cell, ...]] = []
    for cause in solution.causes:
        role, effect = "text", "a warning"
        if cause.blocking:
            role, effect = "warn", "a reason for not accepting"
        probability = Figure(cause.probability, units.SHARE, digits=2, role=role)
        rows.append((cause.code, probability, effect, cause.text, cause.remedy))
    return None if not rows else FactTable(
        ident="causes",
        title="What may be wrong, with their probability",
        columns=(
            *words("cause"),
            *figures("probability", unit=units.SHARE.unit),
            *words(""),
            *words("what", "what to do", detail=True),
        ),
        rows=tuple(rows),
    )  # fmt: skip


def tests_table(solution: Solution) -> FactTable | None:
    """Return the table of the verdict's hypothesis tests, marking those above their threshold; None if no tests."""
    rows: list[tuple[Cell, ...]] = []
    for t in solution.adjudication.tests:
        statistic = Figure(t.statistic, role="warn" if t.fires else "text")
        rows.append((t.code, statistic, Figure(t.threshold), Figure(t.false_alarm, digits=2)))
    return None if not rows else FactTable(
        ident="tests",
        title="Tests behind the verdict (no unit)",
        columns=(*words("test"), *figures("statistic", "threshold", "false alarm")),
        rows=tuple(rows),
        note="A test fires (▲) above its threshold; false alarm is the rate at which sound sets fire it.",
        detail=True,
    )  # fmt: skip
