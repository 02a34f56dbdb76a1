"""Sections on what was found: warnings, parameters, D-H table, noise, how well the poses determine it."""

from __future__ import annotations

import math

from operator_app.report import tables
from operator_app.report.markup import element, join
from operator_app.report.numbers import plural, significant
from operator_app.report.provenance import SAME
from operator_app.report.section import Section, definitions, prose, remark, sentence
from operator_app.report.subject import Subject
from operator_app.report.text import CONDITION_ACCEPTABLE, CONDITION_PAPER
from solver.estimators.estimate import Estimate

CHI2_LEVEL = 0.01
"""Noise models that give so large a chi2 less often than this are said to be wrong."""

SMALLEST_P = 1e-12

INDEX_MEANINGS = (
    "geometric mean of the singular values over root m",
    "smallest over largest singular value",
    "smallest singular value",
    "its square over the largest",
    "one over the sum of inverses",
)


def warnings(subject: Subject) -> Section | None:
    """Return what the operator should know and do; None when there is nothing."""
    texts = [] if subject.solution is None else [n.text for n in subject.solution.warnings]
    texts += [
        f"{d}: take poses that differ more, or hold one of them" for d in subject.unidentifiable
    ]
    if subject.solution is not None and (doubt := noise_doubt(subject.solution.estimate)):
        texts.insert(0, doubt)
    drift = subject.drift_from_journal
    if drift is not None and drift > SAME:
        texts.append(
            f"solving again gives other parameters than the session recorded, by up to "
            f"{significant(drift, 2)} rad or m: the program has changed since; export again if these "
            "are the ones to use"
        )
    if subject.torn:
        texts.append(f"{subject.torn}: nothing that counted was in it")
    if not texts:
        return None
    glyph = element("span", "▲ ", class_="glyph", aria_hidden="true")
    items = [element("li", glyph, prose(sentence(text))) for text in texts]
    return Section(
        ident="warnings",
        title=plural(len(items), "warning"),
        content=(element("ul", *items, class_="warnings"),),
    )


def noise_doubt(estimate: Estimate) -> str:
    """Say so when the stated noise cannot have given these residuals; empty when it can."""
    if estimate.chi2 is None or estimate.chi2_per_dof is None:
        return ""
    from scipy.special import chdtrc

    if float(chdtrc(estimate.dof, estimate.chi2)) >= CHI2_LEVEL:
        return ""
    factor = significant(math.sqrt(estimate.chi2_per_dof), 2)
    return (
        f"chi2/dof is {significant(estimate.chi2_per_dof)} where 1 is expected: sensors or fixture "
        "are worse than stated, so every sigma and interval below is too small, by a factor of "
        f"{factor} if the excess is spread evenly; look at the corrections by joint, and leave out "
        "the readings of joints that are marked there"
    )


def parameters(subject: Subject, estimate: Estimate) -> Section:
    """Return both estimators' parameters."""
    words = (
        f"{plural(len(estimate.parameters), 'parameter')} from {plural(len(subject.used), 'pose')}. "
        "Change is identified less nominal, difference is this estimator less the chosen one, angles "
        "the short way round. "
    )
    words += (
        "Sigma and the 95 % interval follow from the noise of the sensors."
        if estimate.chi2 is not None
        else "Sigma and the 95 % interval (Student's) follow from the size of the residuals."
    )
    if subject.checks.jackknife_sd is not None and estimate.estimator == "implicit":
        words += (
            " The jackknife leaves out each pose in turn: where it is much larger than sigma, the noise "
            "model is too good to be true."
        )
    if subject.paper is None:
        words += " The paper's estimator needs every joint sensed and is not shown beside it."
    elif subject.implicit is None:
        words += " The implicit estimator found no solution to show beside it."
    return Section(
        ident="parameters",
        title="Parameters",
        content=(tables.parameter_table(subject, estimate), remark(words)),
    )


def dh(subject: Subject, estimate: Estimate) -> Section | None:
    """Return the D-H table; None for a loop that has none."""
    made = tables.dh_table(subject, estimate)
    return None if made is None else Section(ident="dh", title="D-H table", content=(made,))


def noise(subject: Subject) -> Section | None:
    """Return the noise that was found with the parameters; None where it was not asked for."""
    solution = subject.implicit_solution
    if solution is None or solution.components is None:
        return None
    found = solution.components
    content: list[str] = []
    if found.components:
        content.append(tables.component_table(found.components))
    if found.flexure is not None:
        p_value = found.flexure.p_value
        chance = f"= {significant(p_value, 2)}" if p_value > SMALLEST_P else "< 10⁻¹²"
        content.append(
            remark(
                "The data ask for a fixture that gives"
                if found.flexure.gives
                else "The data do not ask for a fixture that gives",
                f" (likelihood-ratio test, p {chance}).",
            )
        )
    if not content:
        return None
    return Section(ident="noise", title="Noise found with the parameters", content=tuple(content))


def determined(subject: Subject) -> Section | None:
    """Return condition numbers, rank and observability."""
    if subject.solution is None:
        return None
    seen, estimate = subject.solution.seen, subject.solution.identified
    weakest = [
        f"{name} {significant(weight, 2)}"
        for name, weight in zip(seen.weakest.parameters[:4], seen.weakest.weights, strict=False)
    ]
    others = len(seen.weakest.parameters) - len(weakest)
    indices = [
        join((element("b", f"O{k}"), f" {significant(value)} ({meaning})"))
        for k, (value, meaning) in enumerate(
            zip(seen.observability, INDEX_MEANINGS, strict=True), 1
        )
    ]
    scaled = (
        f"{significant(seen.scaled_condition_number)}; below {CONDITION_ACCEPTABLE} is acceptable, "
        f"the paper had {CONDITION_PAPER}"
    )
    freedom = (
        f"{estimate.dof}: {plural(len(subject.used), 'pose')} with "
        f"{subject.solution.model.equations_per_pose} equations each, less the parameters"
    )
    rows = [
        ("Condition number, columns scaled", scaled),
        ("Condition number, 1 m : 1 rad", significant(seen.condition_number)),
        ("Rank", f"{seen.rank} of {plural(len(estimate.parameters), 'parameter')}"),
        ("Weakest direction", ", ".join(weakest) + (f" and {others} more" if others > 0 else "")),
        ("Observability (no unit)", join(indices, "; ")),
        ("Degrees of freedom", freedom),
    ]
    return Section(
        ident="determined", title="How well the poses determine them", content=(definitions(rows),)
    )
