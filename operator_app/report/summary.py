"""The head of a report: whether it is simulated, the verdict with its reasons, the figures that sum it up."""

from __future__ import annotations

from operator_app.report.markup import Html, element
from operator_app.report.numbers import significant
from operator_app.report.section import bullets, sentence
from operator_app.report.subject import Subject


def verdict_words(subject: Subject) -> str:
    """Return the verdict in a word or two."""
    if subject.solution is None:
        return "Not identifiable"
    return "Accepted" if subject.solution.accepted else "Not accepted"


def banner(subject: Subject) -> Html:
    """Say that the arm was a simulated one; nothing for a real one."""
    if not subject.simulated:
        return Html("")
    scenario = subject.settings.get("scenario")
    words = "SIMULATED: the drives said that they are virtual"
    return element("p", f"{words}; scenario {scenario}" if scenario else words, class_="simulated")


def verdict(subject: Subject) -> Html:
    """Return the verdict, which arm it is about, and why it is not better."""
    solution = subject.solution
    good = solution is not None and solution.accepted
    when = subject.opened_utc[:16].replace("T", " ")
    said: list[str] = [
        element(
            "h1",
            element("span", "✓ " if good else "✕ ", class_="glyph", aria_hidden="true"),
            verdict_words(subject),
        ),
        element(
            "p",
            f"Calibration of {subject.procedure.arm.name}, serial "
            f"{subject.serial_number or 'not known'}, in fixture {subject.procedure.fixture.name}, "
            f"{when} UTC.",
            " The limits of the procedure are met." if good else "",
        ),
    ]
    reasons = (
        [str(direction) for direction in subject.unidentifiable]
        if solution is None
        else list(solution.reasons)
    )
    if reasons:
        said.append(bullets(sentence(reason) for reason in reasons))
    return element("div", *said, class_="verdict" if good else "verdict no")


def tiles(subject: Subject) -> Html:
    """Return the figures that sum a calibration up."""
    solution = subject.solution
    left_out = len(subject.poses) - len(subject.used)
    poses = _tile("poses used", str(len(subject.used)), "", f"{left_out} left out")
    if solution is None:
        return element("dl", poses, class_="tiles")
    estimate, before, seen = solution.identified, solution.before, solution.seen
    shown = [
        _tile(
            "sigma_pos, rms",
            significant(1e3 * estimate.sigmas.position_m.rms),
            "mm",
            f"before {significant(1e3 * before.position_m.rms)} mm",
        )
    ]
    if estimate.rotation_rows:
        shown.append(
            _tile(
                "sigma_ori, rms",
                significant(1e3 * estimate.sigmas.orientation_rad.rms),
                "mrad",
                f"before {significant(1e3 * before.orientation_rad.rms)} mrad",
            )
        )
    limit = subject.procedure.acceptance.scaled_condition_number
    shown += [
        _tile(
            "scaled condition",
            significant(seen.scaled_condition_number),
            "",
            f"limit {limit:g}",
        ),
        _tile("rank", f"{seen.rank}", f"of {len(estimate.parameters)}", "parameters seen"),
    ]
    if estimate.chi2_per_dof is not None:
        fitted = solution.components is not None and solution.components.components
        shown.append(
            _tile(
                "chi2/dof",
                significant(estimate.chi2_per_dof),
                "",
                "noise fitted with it" if fitted else "1 expected",
            )
        )
    return element("dl", *shown, poses, class_="tiles")


def _tile(name: str, value: str, unit: str, below: str) -> Html:
    return element(
        "div",
        element("dt", name),
        element("dd", value, *([" ", element("span", unit, class_="unit")] if unit else [])),
        element("dd", below, class_="was"),
    )
