"""Where a report's numbers come from: which arm, when, with what, and by which method. Knows no style."""

from __future__ import annotations

from operator_app.report.markup import element
from operator_app.report.numbers import names, plural, significant
from operator_app.report.section import Section, bullets, definitions
from operator_app.report.subject import Subject

SAME = 1e-9
"""Solving again on another machine may differ by rounding (rad, m); more is another result."""

PAPER = (
    "paper: unweighted least squares of the closure errors, 1 m counted as 1 rad, damped and with "
    "scaled columns (eqs. 5, 6, 10-13)."
)
IMPLICIT = (
    "implicit: the joint readings are what is uncertain, each by its sensor's noise; every loop closes "
    "exactly at the corrected joints, and the corrections are as small as the noise allows."
)
SIGMAS = (
    "sigma_pos and sigma_ori (eqs. 14, 15) are computed at the measured joints, twice: rms divides by "
    "the number of components inside the root, as printed divides outside it."
)
CONDITION = (
    "Condition number, rank and observability are those of the reduced Jacobian on the closed loops "
    "next to the poses."
)


def facts(subject: Subject) -> Section:
    """Return arm, fixture, time, software and pose set."""
    procedure = subject.procedure
    fixture = procedure.fixture
    position = [j for j, mode in enumerate(subject.modes, 1) if mode == "position"]
    rows: list[tuple[str, str]] = [
        ("Arm", f"{procedure.arm.name}, {plural(procedure.arm.joint_count, 'joint')}"),
        ("Serial number", subject.serial_number or "not known"),
        ("Fixture", f"{fixture.name} ({fixture.kind})"),
        ("Procedure", procedure.name),
    ]
    chosen = {k: v for k, v in subject.settings.items() if v is not None}
    if chosen:
        said = (f"{key.replace('_', ' ')} {_plain(value)}" for key, value in chosen.items())
        rows.append(("Chosen beside it", ", ".join(said)))
    held = f"{names(position)}; the others free" if position else "not recorded"
    rows += [
        ("Joints in position mode", held),
        ("Session", subject.name),
        ("First, last event (UTC)", f"{_utc(subject.opened_utc)}, {_utc(subject.last_utc)}"),
        ("Software", f"sarcal {subject.software_version}"),
        ("Pose set, SHA-256", element("span", subject.pose_set_sha256, class_="mono")),
    ]
    return Section(ident="what", title="What was calibrated", content=(definitions(rows),))


def method(subject: Subject) -> Section:
    """Return how every number on the page was made."""
    samples = sorted({p.samples for p in subject.poses})
    still = (
        f"Every pose is the mean of {names(samples)} samples of all joints, taken when the arm stood "
        "still; sd is the spread of those samples."
    )
    points = [still]
    if subject.solution is not None:
        points += _solving(subject)
    points.append(
        f"The page was made from the {plural(subject.events, 'event')} of the session's journal alone."
    )
    drift = subject.drift_from_journal
    if drift is not None and drift <= SAME:
        exactly = "bit for bit" if drift == 0.0 else f"to within {significant(drift, 2)} rad or m"
        points.append(f"Solving again gave the parameters the session had recorded, {exactly}.")
    return Section(ident="method", title="How the numbers were made", content=(bullets(points),))


def _solving(subject: Subject) -> list[str]:
    if subject.solution is None:
        return []
    estimate, fixture = subject.solution.identified, subject.procedure.fixture
    tolerance = (
        f"{significant(1e3 * fixture.tolerance_m, 2)} mm and "
        f"{significant(1e3 * fixture.tolerance_rad, 2)} mrad"
    )
    loop = (
        "The hand closes a loop through the fixture. Each pose gives "
        f"{plural(subject.solution.model.equations_per_pose, 'equation')} once the angles that "
        "nothing measures are eliminated."
    )
    nearest = (
        "Of the equal descriptions that a loop has, the one nearest to the fixture's nominal placement "
        f"is given; that was measured to {tolerance}."
    )
    ended = "converged" if estimate.converged else "did not converge"
    took = (
        f"The {estimate.estimator} estimator took {plural(estimate.iterations, 'iteration')} and "
        f"{ended}."
    )
    return [loop, IMPLICIT, PAPER, took, SIGMAS, CONDITION, nearest]


def _utc(stamp: str) -> str:
    return stamp[:19].replace("T", " ")


def _plain(value: object) -> str:
    return names(value) if isinstance(value, (list, tuple)) else str(value)
