"""A report says what the session measured and what was found, in a page that is whole and harmless."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.headless.runner import run
from operator_app.report.before_after import arm_pair, hand_pair
from operator_app.report.html import report_html
from operator_app.report.subject import Subject, subject_of_session
from operator_app.session.calibrated import calibrated, checked
from operator_app.session.journal import JOURNAL_NAME, Event, read_journal
from operator_app.session.listener import Listener
from operator_app.session.replay import replay
from operator_app.session.session import Session
from solver.errors import UnidentifiableError

MakeSession = Callable[..., Session]
HOSTILE = '<script>alert("1")</script></td></table>\u202e & \x07\ud800'
DIMENSIONLESS = {"times noise", "gain, reading per angle", "gain", "chi2"}


def procedure(poses: int) -> Procedure:
    from hardware.virtual.scenarios import scenario

    found = load_procedure("hinge")
    return replace(
        found,
        arm=scenario("datasheet").arm(found.arm),
        capture=replace(found.capture, poses=poses, samples_per_pose=8),
    )


def subject_of(events: Sequence[Event], **options: Any) -> Subject:
    """As `sarcal report` reads a journal."""
    state = replay((e.name, e.data, e.utc) for e in events)
    try:
        found = calibrated(state, procedure(16), **options)
    except UnidentifiableError as error:
        directions = error.directions
        return subject_of_session("session", events, procedure(16), None, unidentifiable=directions)
    return subject_of_session(
        "session", events, procedure(16), checked(found, state, procedure(16))
    )


BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")
LOOK = """
<iframe id="f"></iframe><pre id="r"></pre><script>
const frame = document.getElementById('f'), said = [];
frame.srcdoc = PAGE;
frame.onload = () => {
  for (const width of [1280, 1920]) {
    frame.style.width = width + 'px';
    for (const region of frame.contentDocument.querySelectorAll('.scroll'))
      said.push([width, region.firstElementChild.className, region.scrollWidth - region.clientWidth]);
  }
  frame.style.width = '390px';
  const whole = frame.contentDocument.documentElement;
  said.push([390, 'page', whole.scrollWidth - whole.clientWidth]);
  document.getElementById('r').textContent = said.map(s => s.join(' ')).join(';');
};
</script>
"""


@pytest.fixture(scope="module")
def recorded() -> dict[str, Any]:
    """What this module's tests share: the journal is captured once and solved once."""
    return {}


@pytest.fixture
def folder(make_session: MakeSession, recorded: dict[str, Any], tmp_path: Path) -> Path:
    """A session of 16 poses on the virtual plant; one is excluded, one has a hostile note."""
    where = tmp_path / "session"
    if "hinge" in recorded:
        where.mkdir()
        (where / JOURNAL_NAME).write_bytes(recorded["hinge"])
        return where
    session = make_session(procedure(16), "datasheet")
    run(session, Listener())
    session.exclude(4, "bumped the table <b>")
    session.note(7, HOSTILE.replace("\ud800", ""))
    session.check(session.calibrate())
    session.close("done")
    recorded["hinge"] = (where / JOURNAL_NAME).read_bytes()
    return where


@pytest.fixture
def subject(folder: Path, recorded: dict[str, Any]) -> Subject:
    if "subject" not in recorded:
        recorded["subject"] = subject_of(read_journal(folder).events)
    found = recorded["subject"]
    assert isinstance(found, Subject)
    return found


@pytest.fixture
def page(subject: Subject, take_apart: type) -> object:
    return take_apart(report_html(subject).decode())


def test_the_page_is_whole_and_loads_nothing(page: object, subject: Subject) -> None:
    source = report_html(subject).decode()
    assert page.errors == []
    assert not {"script", "img", "link", "iframe", "object", "form", "input"} & set(page.tags)
    assert "http:" not in source
    assert "https:" not in source
    assert "url(" not in source
    links = [value for _, name, value in page.attributes if name in ("href", "src", "action")]
    anchors = {value for _, name, value in page.attributes if name == "id"}
    assert all(link.startswith("#") and link[1:] in anchors for link in links)
    assert not [name for _, name, _ in page.attributes if name.startswith("on") or name == "style"]
    assert ("html", "lang", "en") in page.attributes
    identifiers = [value for _, name, value in page.attributes if name == "id"]
    assert len(set(identifiers)) == len(identifiers)
    policy = [v for _, name, v in page.attributes if name == "content" and "default-src" in v]
    assert policy == [
        "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
    ]


def test_notes_stay_text(page: object, subject: Subject) -> None:
    source = report_html(subject).decode()
    assert "alert(" in page.text
    assert "<script" not in source
    poses = page.rows("Captured poses")
    assert poses[6][-1].startswith('<script>alert("1")</script></td></table>')
    assert "\x07" not in source
    assert poses[3][-1] == "✕ excluded: bumped the table <b>"


def test_a_note_that_no_text_can_hold_is_marked(subject: Subject) -> None:
    poses = tuple(replace(p, note=HOSTILE) for p in subject.poses)
    other = replace(subject, state=replace(subject.state, poses=poses))
    assert "\ufffd" in report_html(other).decode()


def test_the_same_journal_gives_the_same_page(folder: Path, subject: Subject) -> None:
    again = subject_of(read_journal(folder).events)
    assert report_html(again) == report_html(subject)


def test_every_column_of_numbers_has_a_unit(
    page: object, find_missing_units: Callable[..., list[str]]
) -> None:
    assert find_missing_units(page, DIMENSIONLESS) == []


def test_pictures_are_named_and_headers_scoped(page: object) -> None:
    pictures = [i for i, tag in enumerate(page.tags) if tag == "svg"]
    assert len(pictures) >= 4
    named = [value for tag, name, value in page.attributes if (tag, name) == ("svg", "role")]
    assert named == ["img"] * len(pictures)
    assert page.tags.count("desc") == len(pictures)
    headers = page.tags.count("th")
    scopes = [value for tag, name, value in page.attributes if (tag, name) == ("th", "scope")]
    assert len(scopes) == headers
    assert set(scopes) == {"col", "row", "colgroup"}
    assert page.tags.count("caption") == page.tags.count("table")


def test_the_verdict_comes_first_with_arm_serial_fixture_and_time(
    page: object, subject: Subject
) -> None:
    assert page.tags.index("h1") < page.tags.index("h2")
    for words in (
        "Accepted",
        "sarcos_dextrous, serial SDA-0001, in fixture hinge, 2026-01-31 12:00 UTC",
        subject.state.pose_set().sha256(),
        f"sarcal {subject.software_version}",
    ):
        assert words in page.text


def number(words: str) -> float:
    return float(words.replace("\u2212", "-"))


def test_parameters_are_those_of_the_solution(page: object, subject: Subject) -> None:
    assert subject.solution is not None
    estimate = subject.solution.identified
    rows = page.rows("Identified parameters")
    assert [row[0] for row in rows] == [p.name for p in estimate.parameters]
    for row, p, value, sd in zip(
        rows, estimate.parameters, estimate.x, estimate.standard_deviation, strict=True
    ):
        scale = 180.0 / math.pi if p.is_angle else 1e3
        assert row[1] == ("deg" if p.is_angle else "mm")
        resolution = 10.0 ** -len(row[3].partition(".")[2])
        assert number(row[2]) == pytest.approx(p.nominal * scale, abs=0.005)
        assert number(row[3]) == pytest.approx(value * scale, abs=resolution)
        assert number(row[4]) == pytest.approx((value - p.nominal) * scale, abs=resolution)
        assert number(row[5]) == pytest.approx(sd * scale, abs=resolution)
        # Two figures of every sigma are there.
        assert number(row[5]) >= 0.9 * resolution
        low, high = number(row[7]), number(row[8])
        assert high - low == pytest.approx(2.0 * 1.96 * sd * scale, abs=3.0 * resolution)


def test_both_estimators_stand_side_by_side(page: object, subject: Subject) -> None:
    assert subject.solution is not None
    assert subject.implicit is not None
    paper = subject.solution.paper
    assert paper is not None
    assert paper is not subject.implicit
    assert "implicit (chosen)" in page.text
    row = page.rows("Identified parameters")[0]
    assert number(row[-1]) == pytest.approx(math.degrees(paper.x[0]), abs=1e-3)
    name, _, value, sigma, theirs, its_sigma, difference = page.rows("Both estimators")[0]
    assert name == "theta_off_1"
    assert number(value) == pytest.approx(math.degrees(subject.implicit.x[0]), abs=1e-3)
    assert number(theirs) == pytest.approx(math.degrees(paper.x[0]), abs=1e-3)
    for shown, estimate in ((sigma, subject.implicit), (its_sigma, paper)):
        expected = math.degrees(estimate.standard_deviation[0])
        assert number(shown) == pytest.approx(expected, rel=0.06)
    change = math.degrees(paper.x[0] - subject.implicit.x[0])
    assert number(difference) == pytest.approx(change, abs=1e-3)
    assert "Believe implicit" in page.text


def test_closure_before_and_after_in_both_readings(page: object, subject: Subject) -> None:
    assert subject.solution is not None
    rows = {row[0]: [number(cell) for cell in row[1:]] for row in page.rows("Closure at")}
    before, after = subject.solution.before, subject.solution.estimate.sigmas
    for name, sigmas in (("nominal, before", before), ("implicit (chosen), after", after)):
        expected = [
            1e3 * sigmas.position_m.rms,
            1e3 * sigmas.position_m.as_printed,
            1e3 * sigmas.orientation_rad.rms,
            1e3 * sigmas.orientation_rad.as_printed,
        ]
        assert rows[name] == pytest.approx(expected, rel=1e-3)
    # No larger than the others by necessity: the implicit estimator does not minimise this figure.
    held_out = next(values for name, values in rows.items() if "held out" in name)
    assert subject.checks is not None
    assert subject.checks.held_out is not None
    outside = subject.checks.held_out.sigmas
    assert held_out[0] == pytest.approx(1e3 * outside.position_m.rms, rel=1e-3)
    assert held_out[2] == pytest.approx(1e3 * outside.orientation_rad.rms, rel=1e-3)


def test_before_and_after_stand_side_by_side(page: object, subject: Subject) -> None:
    assert subject.solution is not None
    assert subject.solution.accuracy is not None
    hand = hand_pair(subject.solution, subject.procedure.arm)
    arm = arm_pair(subject)
    assert hand is not None
    assert arm is not None
    for pair in (hand, arm):
        assert (pair.before.x, pair.before.y) == (pair.after.x, pair.after.y)
        for picture in (pair.before, pair.after):
            assert picture.title in page.text
            assert picture.x.high - picture.x.low == pytest.approx(
                picture.aspect * (picture.y.high - picture.y.low)
            )
    # The largest mark is of area 1, all others in proportion to what the table sums up.
    worst = subject.solution.accuracy.before.worst
    for picture, spread in (
        (hand.before, subject.solution.accuracy.before),
        (hand.after, subject.solution.accuracy.after),
    ):
        (marks,) = picture.layers
        assert max(marks.sizes) * worst == pytest.approx(spread.worst)
        assert np.sqrt(np.mean(np.square(marks.sizes))) * worst == pytest.approx(spread.rms)
        said = re.search(r", rms ([\d.]+) mm$", picture.title)
        assert said is not None
        assert float(said[1]) == pytest.approx(1e3 * spread.rms, rel=5e-3)
    # The gap is that of the pose's loop, from the table of poses.
    number_, size = re.fullmatch(
        r"After: the loop of pose (\d+) stays open by ([\d.]+) mm", arm.after.title
    ).groups()
    (row,) = (row for row in page.rows("Captured poses") if row[0] == number_)
    assert number(size) == pytest.approx(number(row[10]), rel=5e-3)
    before = float(arm.before.title.split()[-2])
    assert before > 3.0 * number(size)
    # Chain and gap are drawn to scale.
    factor = re.search(r"drawn (\d+) times", arm.after.description + arm.before.title + arm.note)
    times = 1.0 if factor is None else float(factor[1])
    (gap,) = (layer for layer in arm.before.layers if layer.label == "gap")
    assert np.hypot(np.ptp(gap.x), np.ptp(gap.y)) <= 1.01 * times * before


def test_of_whose_parameter_it_is_the_page_says(page: object, subject: Subject) -> None:
    whose = {row[0]: row[9] for row in page.rows("Identified parameters")}
    assert whose["theta_off_3"] == "arm"
    assert (whose["a_0"], whose["theta_off_1"]) == ("ground", "ground")
    assert (whose["alpha_7"], whose["theta_off_7"]) == ("hand", "hand")
    assert subject.facts is not None
    assert subject.facts.data["side"] == whose


def test_poses_and_joints_are_all_there(page: object, subject: Subject) -> None:
    poses = page.rows("Captured poses")
    assert [row[0] for row in poses] == [str(p.number) for p in subject.poses]
    assert "Excluded by the operator: 4" in page.text
    for row, pose in zip(poses, subject.poses, strict=True):
        assert [number(cell) for cell in row[2:9]] == pytest.approx(
            np.rad2deg(pose.mean_rad).tolist(), abs=6e-4
        )
    assert poses[3][10] == "n/a"
    joints = page.rows("Joints:")
    assert [row[2] for row in joints] == [
        "position", "free", "free", "free", "position", "free", "free",
    ]  # fmt: skip
    assert "RVDT, 12 bit over 120 deg" in joints[5][1]
    low = np.rad2deg(subject.readings_rad).min(axis=0)
    assert [number(row[6]) for row in joints] == pytest.approx(low.tolist(), abs=0.006)


def test_rvdt_verdicts_and_condition_are_told(page: object, subject: Subject) -> None:
    assert subject.solution is not None
    assert len(subject.solution.rvdt) == 2
    for verdict in subject.solution.rvdt:
        assert verdict.text in page.text
    rows = {row[0]: row[1:] for row in page.rows("How well the poses")}
    condition = subject.solution.seen.scaled_condition_number
    assert number(rows["scaled condition number"][0]) == pytest.approx(condition, rel=5e-3)
    assert "limit 100" in rows["scaled condition number"][1]
    assert rows["rank"] == ["14", "of 14"]
    shown = [number(row[1]) for row in page.rows("Observability")]
    assert shown == pytest.approx(list(subject.solution.seen.observability), rel=5e-3)


def test_a_solution_that_is_not_the_journals_is_said(subject: Subject, take_apart: type) -> None:
    assert subject.solved_again == ""
    assert "its solution was read, not made again" in take_apart(report_html(subject).decode()).text
    other = take_apart(report_html(replace(subject, solved_again="it is of old")).decode())
    assert "Solved again for this report: it is of old." in other.text
    assert "not made again" not in other.text


def test_second_opinions_that_nobody_asked_for_are_said_to_be_missing(
    subject: Subject, take_apart: type
) -> None:
    assert "hold-out" not in take_apart(report_html(subject).decode()).text
    other = take_apart(report_html(replace(subject, checks=None)).decode())
    assert "sarcal run --resume session asks it." in other.text
    assert "held out" not in " ".join(row[0] for row in other.rows("Closure at"))


def test_simulated_is_said_and_real_is_not(subject: Subject, take_apart: type) -> None:
    assert "SIMULATED" not in take_apart(report_html(subject).decode()).text
    state = replace(subject.state, settings={"scenario": "wild"})
    told = report_html(replace(subject, simulated=True, state=state)).decode()
    text = take_apart(told).text
    assert text.index("SIMULATED") < text.index("Accepted")
    assert "scenario wild" in text


def test_the_paper_may_be_the_chosen_one(folder: Path, take_apart: type) -> None:
    subject = subject_of(read_journal(folder).events, estimator="paper")
    assert subject.solution is not None
    page = take_apart(report_html(subject).decode())
    assert "paper (chosen)" in page.text
    assert subject.implicit is not None
    # Student's interval: the noise was estimated from the residuals.
    estimate = subject.solution.estimate
    from scipy.stats import t

    row = page.rows("Identified parameters")[0]
    half = t.ppf(0.975, estimate.dof) * math.degrees(estimate.standard_deviation[0])
    assert number(row[7]) - number(row[6]) == pytest.approx(2.0 * half, rel=0.02)


def test_joints_left_out_are_said_to_be(folder: Path, take_apart: type) -> None:
    subject = subject_of(read_journal(folder).events, unsensed_joints=(6, 7))
    page = take_apart(report_html(subject).decode())
    assert page.errors == []
    assert "The readings of joints 6 and 7 were not used" in page.text
    assert "theta_off_6" not in [row[0] for row in page.rows("Identified parameters")]
    assert "The paper's estimator needs every joint sensed" in page.text
    assert page.rows("Joints:")[5][1].endswith("(reading not used)")


def test_what_cannot_be_identified_is_reported_without_numbers(
    folder: Path, take_apart: type
) -> None:
    events = [e for e in read_journal(folder).events if e.name not in ("solved", "checked")]
    for k, event in enumerate(events):
        if event.name == "pose":
            still = [*event.data["mean_rad"]]
            still[3] = -2.0
            events[k] = replace(event, data={**event.data, "mean_rad": still})
    subject = subject_of(events)
    assert subject.solution is None
    page = take_apart(report_html(subject).decode())
    assert page.errors == []
    assert "Not identifiable" in page.text
    assert "joint 4 does not move" in page.text
    assert "condition" not in page.text
    assert len(page.rows("Captured poses")) == 16


@pytest.mark.skipif(BROWSER is None, reason="needs Chromium")
def test_no_table_is_cut_on_a_laptop_or_a_screen_and_no_page_on_a_phone(
    subject: Subject, tmp_path: Path
) -> None:
    page = report_html(subject).decode()
    page = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page)
    page = page.replace("</html>", "").replace("</script>", "")
    html = "<!DOCTYPE html>" + LOOK.replace("PAGE", json.dumps(page).replace("</", "<\\/"))
    (tmp_path / "look.html").write_text(html)
    found = subprocess.run(
        [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=2000",
         f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", f"file://{tmp_path}/look.html"],
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    said = re.search(r'<pre id="r">([^<]+)</pre>', found)
    assert said is not None, found[-2000:]
    regions = [entry.split() for entry in said[1].split(";")]
    seen = {(width, name) for width, name, _ in regions}
    for name in ("parameters", "budget", "pose-table", "estimators", "correlations"):
        assert {("1280", name), ("1920", name)} <= seen
    # On a phone wide tables scroll, each by itself; the page does not.
    assert ("390", "page") in seen
    assert [r for r in regions if int(r[-1]) > 0] == []
