"""A calibration in words and tables, for a terminal of 80 columns. Computes nothing, prints nothing."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Sequence

from operator_app.calibration.checks import FOLDS, Checks
from operator_app.calibration.judgement import Notice
from operator_app.calibration.solve import Solution
from solver.chain.parameters import DhEntry, DhKind, nominal_vector
from solver.errors import UnidentifiableDirection
from solver.estimators.estimate import Estimate
from solver.estimators.goodness import TwoReadings
from solver.estimators.variance_components import VarianceComponents

WIDTH = 80
CONDITION_ACCEPTABLE = 100
CONDITION_PAPER = 28


def solution_text(solution: Solution) -> str:
    """Return everything an operator should read after a calibration, most important first."""
    blocks = [
        _verdict(solution),
        parameter_table(solution),
        dh_table(solution),
        _quality(solution),
        warnings_text(solution.warnings),
    ]
    return "\n\n".join(block for block in blocks if block)


def parameter_table(solution: Solution) -> str:
    """Return nominal, identified, change and standard deviation of every parameter."""
    estimate, paper = solution.identified, solution.paper
    beside = paper is not None and paper is not estimate
    rows = [["parameter", "unit", "nominal", "identified", "change", "sigma"]]
    if beside:
        rows[0].append("by `paper`")
    for k, p in enumerate(estimate.parameters):
        unit, scale = ("deg", 180.0 / math.pi) if p.is_angle else ("mm", 1e3)
        value, sigma = float(estimate.x[k]), float(estimate.standard_deviation[k])
        change = value - p.nominal
        if p.is_angle:
            change = math.remainder(change, 2.0 * math.pi)
        row = [
            p.name,
            unit,
            f"{p.nominal * scale:.2f}",
            f"{value * scale:.4f}",
            f"{change * scale:+.3f}",
            f"{sigma * scale:.4f}",
        ]
        if beside and paper is not None:
            row.append("" if p.name in solution.tolerated else f"{paper.value(p.name) * scale:.3f}")
        rows.append(row)
    return f"Parameters ({_estimator_words(estimate)})\n" + aligned(rows)


def dh_table(solution: Solution) -> str:
    """Return the identified D-H table beside the nominal one, as the paper's Tables 1 and 2.

    Nothing for a loop that has none.
    """
    model = solution.model
    before = model.dh_table(nominal_vector(model.parameters))
    after = model.dh_table(solution.estimate.x)
    if before is None or after is None:
        return ""
    nominal, found = before.stacked(), after.stacked()
    free = set(model.entries)
    columns = (
        (DhKind.A, "a_j [m]", 1.0, 4),
        (DhKind.S, "s_j [m]", 1.0, 4),
        (DhKind.ALPHA, "alpha_j [deg]", 180.0 / math.pi, 2),
        (DhKind.THETA_OFF, "theta_off_j [deg]", 180.0 / math.pi, 2),
    )
    rows = [["j"] + [cell for _, title, _, _ in columns for cell in (title.split()[0], "")]]
    rows.append([""] + [cell for _, title, _, _ in columns for cell in (title.split()[1], "found")])
    for row in range(before.links):
        cells = [str(row)]
        for kind, _, scale, places in columns:
            if kind is DhKind.THETA_OFF and (row == 0 or row in model.unsensed_joints):
                cells += ["n/a", ""]
                continue
            known = DhEntry(kind, row) not in free
            cells.append(f"{nominal[kind, row] * scale:.{places - 1}f}")
            cells.append("" if known else f"{found[kind, row] * scale:.{places + 1}f}")
        rows.append(cells)
    return "D-H table: nominal (as Table 1) and, where calibrated, found (as Table 2)\n" + aligned(
        rows, gap=" "
    )


def warnings_text(notices: Iterable[Notice]) -> str:
    """Return warnings, one paragraph each."""
    return "\n".join(paragraph(f"! {n.text}", indent=2) for n in notices)


def checks_text(solution: Solution, checks: Checks) -> str:
    """Return second opinions: hold-out first, then each sigma beside its jackknife."""
    rows = [["hold-out", "", "poses that took part", "poses held out"]]
    for name, found in ((f"{FOLDS} folds", checks.held_out), ("far block", checks.far_block)):
        if found is not None:
            for symbol, unit, inside, outside in (
                ("sigma_pos", "mm", found.inside_sigmas.position_m, found.sigmas.position_m),
                (
                    "sigma_ori",
                    "mrad",
                    found.inside_sigmas.orientation_rad,
                    found.sigmas.orientation_rad,
                ),
            ):
                rows.append(
                    [
                        f"{name}, {symbol}",
                        unit,
                        f"{1e3 * inside.rms:.3f}",
                        f"{1e3 * outside.rms:.3f}",
                    ]
                )
    blocks = [aligned(rows) if len(rows) > 1 else "Hold-out: too few poses."]
    if checks.jackknife_sd is not None:
        estimate = solution.identified
        rows = [["parameter", "unit", "sigma", "jackknife"]]
        for k, p in enumerate(estimate.parameters):
            unit, scale = ("deg", 180.0 / math.pi) if p.is_angle else ("mm", 1e3)
            sigma, other = estimate.standard_deviation[k], checks.jackknife_sd[k]
            rows.append([p.name, unit, f"{sigma * scale:.4f}", f"{other * scale:.4f}"])
        blocks.append(aligned(rows))
    return "\n\n".join(blocks)


def unidentifiable_text(directions: Sequence[UnidentifiableDirection]) -> str:
    """Return why a pose set cannot give what was asked for."""
    lines = ["Not identifiable: these poses cannot determine every parameter."]
    lines += [paragraph(f"! {direction}", indent=2) for direction in directions]
    joints = sorted({j for d in directions for j in d.immobile_joints})
    if joints:
        which = ", ".join(str(j) for j in joints)
        lines.append(
            paragraph(
                f"What to do: use a fixture in which joint {which} moves (the hinge), or leave "
                f"theta_off_{which} out of the free entries of the arm file."
            )
        )
    else:
        lines.append(
            paragraph(
                "What to do: take poses that differ more, or leave one parameter of each line out "
                "of the free entries of the arm file."
            )
        )
    return "\n".join(lines)


def aligned(rows: Sequence[Sequence[str]], gap: str = "  ") -> str:
    """Return rows as columns: the first column to the left, all others to the right."""
    count = max(len(row) for row in rows)
    full = [[*row, *[""] * (count - len(row))] for row in rows]
    widths = [max(len(row[k]) for row in full) for k in range(count)]
    lines = []
    for row in full:
        cells = [row[0].ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        lines.append(("  " + gap.join(cells)).rstrip())
    return "\n".join(lines)


def paragraph(text: str, indent: int = 0) -> str:
    """Wrap one sentence or more to the width of a terminal."""
    return textwrap.fill(text, WIDTH, subsequent_indent=" " * indent, break_long_words=False)


def _verdict(solution: Solution) -> str:
    if solution.accepted:
        return "ACCEPTED: the calibration meets its limits."
    reasons = "\n".join(paragraph(f"- {reason}", indent=2) for reason in solution.reasons)
    return f"NOT ACCEPTED:\n{reasons}"


def _quality(solution: Solution) -> str:
    estimate, seen = solution.identified, solution.seen
    condition = (
        f"Scaled condition number {seen.scaled_condition_number:.1f} "
        f"(below {CONDITION_ACCEPTABLE} is acceptable; the paper had {CONDITION_PAPER}); "
        f"rank {seen.rank} of {len(estimate.parameters)}; {solution.poses} poses, "
        f"{estimate.dof} degrees of freedom, {estimate.iterations} iterations."
    )
    rows = [
        ["", "unit", "before: rms", "as printed", "after: rms", "as printed"],
        _sigma_row("sigma_pos", "mm", solution.before.position_m, estimate.sigmas.position_m),
        _sigma_row(
            "sigma_ori",
            "mrad",
            solution.before.orientation_rad,
            estimate.sigmas.orientation_rad,
        ),
    ]
    blocks = [
        paragraph(condition),
        "Closure at the measured joints (eqs. 14 and 15)\n" + aligned(rows),
    ]
    if estimate.chi2_per_dof is not None:
        blocks.append(
            f"chi2/dof {estimate.chi2_per_dof:.2f} "
            "(1 when sensors and fixture are as good as stated)"
        )
    if solution.components is not None:
        blocks.append(_components(solution.components))
    return "\n".join(block for block in blocks if block)


def _components(found: VarianceComponents) -> str:
    """Noise and flexure found with the parameters, with 95 % intervals."""
    rows = []
    for c in found.components:
        name = c.name.replace("rvdt_", "RVDT noise, joint ").replace("curve_", "RVDT curve, joint ")
        name = {"fixture_m": "fixture gives", "fixture_rad": "fixture turns"}.get(name, name)
        unit = "mm" if c.unit == "m" else "mrad"
        rows.append([name, unit, f"{1e3 * c.sd:.3f}", f"{1e3 * c.low:.3f} to {1e3 * c.high:.3f}"])
    if found.flexure is not None and not found.flexure.gives:
        rows.append(["fixture", "", "rigid", f"p {found.flexure.p_value:.2f}"])
    if not rows:
        return ""
    head = ["", "unit", "rms", "95 % interval"]
    return "Found with the parameters\n" + aligned([head, *rows])


def _sigma_row(name: str, unit: str, before: TwoReadings, after: TwoReadings) -> list[str]:
    values = (before.rms, before.as_printed, after.rms, after.as_printed)
    return [name, unit, *(f"{1e3 * value:.3f}" for value in values)]


def _estimator_words(estimate: Estimate) -> str:
    if estimate.estimator == "paper":
        return "by the paper's unweighted least squares"
    return "by the implicit estimator, joint sensors weighted by their noise"
