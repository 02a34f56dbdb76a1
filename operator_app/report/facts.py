"""Facts of a calibration: verdict, headlines, tables and notices, built once for all renderers.

Text, HTML page, JSON, terminal app and plain mode render these facts and make no decisions. A table that is added to
`facts_of` appears in all of them, but JSON has only figures with a key. `calibration_data` adds further data to JSON.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from operator_app.calibration.acceptance import Verdict
from operator_app.calibration.cross_validation import Checks
from operator_app.calibration.result import Solution
from operator_app.calibration.rvdt import reading_tables
from operator_app.config.procedure import AcceptanceLimits
from operator_app.messages.finding import FindingKind
from operator_app.report import parameter_tables, quality_tables, uncertainty_tables
from operator_app.report.calibration_json import calibration_data, checks_data, estimate_data
from operator_app.report.table import Cell, FactTable, Headline, figures, keyed
from operator_app.units import ANGLE, CHI2, CONDITION, SIGMA_ORI, SIGMA_POS, Figure, Kind
from solver.estimators.estimate import Estimate
from solver.loops.closure import ResidualSigma

CONDITION_PAPER = 28


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """The facts of a calibration, most important first.

    `data`: the part of the JSON object that is in no table.
    """

    solution: Solution
    headlines: tuple[Headline, ...]
    tables: tuple[FactTable, ...]
    data: Mapping[str, Any]

    @property
    def json(self) -> dict[str, Any]:
        """The object that `sarcal solve --json` prints, without the key ``test``."""
        return merged(self.data, keyed(self.tables))

    @property
    def verdict(self) -> str:
        """The verdict in words."""
        return self.solution.verdict.words

    @property
    def notices_are_notes(self) -> bool:
        """Whether the calibration is accepted without warnings, so that its notices are called notes."""
        return self.solution.verdict is Verdict.ACCEPTED

    @property
    def limits_met(self) -> str:
        """Text that an accepted calibration meets its limits, plus "but ..." if the condition number is too large."""
        exceeded = (n for n in self.solution.warnings if n.kind is FindingKind.CONDITION)
        met = "the calibration meets its limits"
        return f"{met}, but its {finding.text}" if (finding := next(exceeded, None)) else met

    def table(self, ident: str) -> FactTable | None:
        """Return the table whose identifier is `ident`; None if the calibration has no such table."""
        return next((t for t in self.tables if t.ident == ident), None)


def facts_of(
    solution: Solution,
    *,
    checks: Checks | None = None,
    limits: AcceptanceLimits | None = None,
    captured: int | None = None,
) -> Facts:
    """Return the facts of a calibration.

    `checks`: cross-validation and jackknife, None if they were not computed. `captured`: number of captured poses,
    including unused ones, None if all were used.
    """
    left_out = 0 if captured is None else captured - solution.poses
    headlines = _headlines(solution, AcceptanceLimits() if limits is None else limits, left_out)
    tables = (
        parameter_tables.parameter_table(solution.identified, solution),
        parameter_tables.instrument_table(solution),
        quality_tables.truth_table(solution),
        quality_tables.causes_table(solution),
        parameter_tables.dh_table(solution),
        uncertainty_tables.best_table_table(solution),
        uncertainty_tables.distance_table(solution),
        quality_tables.hand_table(solution),
        quality_tables.accuracy_table(solution),
        quality_tables.determined_table(solution, headlines),
        quality_tables.trend_table(solution),
        quality_tables.closure_table(solution, checks),
        parameter_tables.estimators_table(solution),
        parameter_tables.jackknife_table(solution, checks),
        uncertainty_tables.components_table(solution),
        uncertainty_tables.scale_table(solution),
        remedy_table(solution),
        uncertainty_tables.budget_table(solution),
        uncertainty_tables.sensitivity_table(solution),
        parameter_tables.tolerated_table(solution),
        quality_tables.tests_table(solution),
        parameter_tables.correlation_table(solution),
    )
    return Facts(
        solution=solution,
        headlines=headlines,
        tables=tuple(table for table in tables if table is not None),
        data=calibration_data(solution)
        | uncertainty_tables.posterior_data(solution)
        | checks_data(checks),
    )


def estimate_json(estimate: Estimate) -> dict[str, Any]:
    """Return the result of one estimator as a JSON object."""
    rows = quality_tables.closure_row(estimate.estimator, estimate.sigmas, key=())
    closure = FactTable(ident="", title="", columns=quality_tables.CLOSURE_COLUMNS, rows=(rows,))
    return merged(
        {**estimate_data(estimate), "chi2_per_dof": estimate.chi2_per_dof},
        keyed((parameter_tables.parameter_table(estimate), closure)),
    )


def merged(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """Return two JSON objects merged at all levels; if both have a value for a key, the value in `other` is used."""
    result = dict(one)
    for key, value in other.items():
        both = isinstance(value, Mapping) and isinstance(result.get(key), Mapping)
        result[key] = merged(result[key], value) if both else value
    return result


def _headlines(solution: Solution, limits: AcceptanceLimits, left_out: int) -> tuple[Headline, ...]:
    estimate, identifiability = solution.identified, solution.identifiability
    before, after = solution.before, estimate.sigmas
    headlines = [_sigma("sigma_pos", SIGMA_POS, before.position_m, after.position_m)]
    turned = before.orientation_rad, after.orientation_rad
    if estimate.rotation_rows and turned[0] is not None and turned[1] is not None:
        headlines.append(_sigma("sigma_ori", SIGMA_ORI, turned[0], turned[1]))
    name = "scaled condition number"
    number = CONDITION(identifiability.scaled_condition_number, key=("scaled_condition_number",))
    note = f"limit {limits.scaled_condition_number:g}, the paper had {CONDITION_PAPER}"
    headlines.append(Headline(name=name, figure=number, note=note))
    rank = Figure(identifiability.rank, places=0, key=("rank",))
    headlines.append(Headline(name="rank", figure=rank, note=f"of {len(estimate.parameters)}"))
    if estimate.chi2_per_dof is not None:
        fitted = solution.components is not None and solution.components.components
        note = "noise fitted with it" if fitted else "1 expected"
        ratio = CHI2(estimate.chi2_per_dof, key=("chi2_per_dof",))
        headlines.append(Headline(name="chi2/dof", figure=ratio, note=note))
    poses = Figure(solution.poses, places=0, key=("poses",))
    note = f"{left_out} left out" if left_out else ""
    return (*headlines, Headline(name="poses", figure=poses, note=note))


def _sigma(name: str, kind: Kind, before: ResidualSigma, after: ResidualSigma) -> Headline:
    return Headline(
        name=name, figure=kind(after.rms), note=f"before {kind(before.rms).with_unit}", closure=True
    )


EVERY = 4
"""One in this many rows of a correction table is shown."""


def remedy_table(solution: Solution) -> FactTable | None:
    """Return the table of the RVDT offsets, gains and corrections that the poses determine; None if there are none."""
    rows: list[tuple[Cell, ...]] = []
    for table in reading_tables(solution):
        offset, gain = Figure(table.theta_off_rad, ANGLE, places=3), Figure(table.gain, places=4)
        head: tuple[Cell, ...] = (str(table.joint), offset, gain)
        columns = (table.reading_rad, table.add_rad, table.sigma_rad)
        for reading, add, sigma in zip(*(c[::EVERY].tolist() for c in columns), strict=True):
            correction = Figure(add, ANGLE, 3, signed=True), Figure(sigma, ANGLE, 3)
            rows.append((*head, Figure(reading, ANGLE, 1), *correction))
            head = ("", "", "")
    if not rows:
        return None
    return FactTable(
        ident="rvdt-remedy",
        title="Corrections of RVDT readings, from the closed loop",
        columns=(
            *figures("joint"),
            *figures("theta_off", unit="deg"),
            *figures("gain"),
            *figures("reading", "add", "sigma", unit="deg"),
        ),
        rows=tuple(rows),
        note="Corrected reading = reading + add, interpolated linearly; theta_off applies to corrected readings. The "
        "corrections include the gain (reading per angle). The parameters file has the whole table: "
        "solve --rvdt-table FILE applies it.",
    )
