"""The report page: complete, self-contained, safe against hostile text; numbers of the session and its solution."""

import json
import math
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t

from operator_app.calibration.tool_accuracy import TrueErrors
from operator_app.report.html.page import report_html
from tests.operator_app.report.conftest import HOSTILE, number, report_subject

WITHOUT_UNIT = {"/ stated", "gain, reading per angle", "gain", "chi2"}


BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")
MEASURE = """
<iframe id="f"></iframe><pre id="r"></pre><script>
const frame = document.getElementById('f'), sizes = [];
frame.srcdoc = PAGE;
frame.onload = () => {
  for (const width of [1280, 1920]) {
    frame.style.width = width + 'px';
    for (const region of frame.contentDocument.querySelectorAll('.scroll'))
      sizes.push([width, region.firstElementChild.className, region.scrollWidth - region.clientWidth]);
  }
  frame.style.width = '390px';
  const root = frame.contentDocument.documentElement;
  sizes.push([390, 'page', root.scrollWidth - root.clientWidth]);
  document.getElementById('r').textContent = sizes.map(s => s.join(' ')).join(';');
};
</script>
"""


def test_page_is_well_formed_self_contained_and_reproducible(page, html, folder):
    assert report_html(report_subject(folder)).decode() == html
    assert not {"script", "img", "link", "iframe", "object", "form", "input"} & set(page.tags)
    assert re.findall(r"https?:|url\(|@import", html) == []
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


def test_hostile_notes_stay_text(page, html, subject):
    assert "alert(" in page.text
    assert "<script" not in html
    poses = page.rows("Captured poses")
    assert poses[6][-1].startswith('<script>alert("1")</script></td></table>')
    assert "\x07" not in html
    assert poses[3][-1] == "✕ excluded: bumped the table <b>"
    invalid = tuple(replace(p, note=HOSTILE) for p in subject.poses)
    other = replace(subject, state=replace(subject.state, poses=invalid))
    assert "\ufffd" in report_html(other).decode()


def test_every_numeric_column_has_a_unit(page):
    missing = []
    for table in page.tables:
        headers = columns_of(table["thead"])
        if any(title == "unit" for title, _ in headers):
            continue
        for column, (title, group) in enumerate(headers):
            numeric = any(row[column][1].get("class") == "n" for row in table["tbody"])
            stated = re.search(r"\[[^\]]+\]|no unit", f"{title} {group} {table['caption']}")
            if numeric and not stated and title not in WITHOUT_UNIT:
                missing.append(f"{table['caption']}: {title}")
    assert missing == []


def columns_of(head):
    if len(head) == 1:
        return [(title, "") for _, _, title in head[0]]
    second = iter(head[1])
    columns = []
    for _, attributes, title in head[0]:
        if attributes.get("rowspan"):
            columns.append((title, ""))
        else:
            columns += [(next(second)[2], title) for _ in range(int(attributes["colspan"]))]
    return columns


def test_pictures_and_headers_are_accessible(page):
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


def test_page_head_names_arm_fixture_time_verdict_widest_sigma_and_tool(page, html, subject):
    head, _, rest = html.partition("<main")
    assert head.index("<h1") < head.index("Widest sigma") < head.index("hand-before")
    assert head.index("hand-before") < head.index("hand-after") < head.index('class="tiles"')
    assert "To halve the source: " in head
    assert "hand-before" not in rest
    assert 'id="warnings"' in rest
    assert page.tags.index("h1") < page.tags.index("h2")
    for words in (
        "Accepted",
        "sarcos_dextrous, serial SDA-0001, in fixture hinge, 2026-01-31 12:00 UTC",
        subject.state.pose_set().sha256(),
        f"sarcal {subject.software_version}",
    ):
        assert words in page.text


@pytest.fixture
def page_with(subject, parse_page):
    return lambda **changes: parse_page(report_html(replace(subject, **changes)).decode())


def test_recalculation_missing_checks_and_simulation_are_stated(page, subject, page_with):
    assert subject.recalculated_because == ""
    assert "its solution was read, not made again" in page.text
    assert "hold-out" not in page.text
    assert "SIMULATED" not in page.text
    again = page_with(recalculated_because="it is of old").text
    assert "The poses were solved again for this report: it is of old." in again
    assert "not made again" not in again
    unchecked = page_with(checks=None)
    assert "sarcal run --resume session computes it." in unchecked.text
    assert "held out" not in " ".join(row[0] for row in unchecked.rows("Closure at"))
    state = replace(subject.state, settings={"scenario": "wild"})
    simulated = page_with(simulated=True, state=state).text
    assert simulated.index("SIMULATED") < simulated.index("Accepted")
    assert "scenario wild" in simulated


def test_page_head_has_true_errors_of_a_simulation(subject, html):
    truth = TrueErrors(inside_95=13, of=14, tool_rms_m=0.00031, predicted_rms_m=0.00042)
    simulated = replace(subject, solution=replace(subject.solution, truth=truth))
    head = report_html(simulated).decode().partition("<main")[0]
    assert "The truth: 13 of 14 entries within their 95 % intervals; with exact readings" in head
    assert "the tool is off by 0.31 mm rms (predicted 0.42)" in head
    assert "The truth" not in html


def test_notes_of_an_accepted_result_are_not_warnings(subject, html):
    assert subject.facts.verdict == "accepted"
    assert 'class="warnings notes"' in html
    assert " warning<" not in html
    refused = replace(subject, solution=replace(subject.solution, reasons=("too far off",)))
    assert 'class="warnings"' in report_html(refused).decode()


@pytest.mark.campaign
@pytest.mark.skipif(BROWSER is None, reason="needs Chromium")
def test_browser_clips_no_table(html, tmp_path):
    page = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", html)
    page = page.replace("</html>", "").replace("</script>", "")
    html = "<!DOCTYPE html>" + MEASURE.replace("PAGE", json.dumps(page).replace("</", "<\\/"))
    (tmp_path / "look.html").write_text(html)
    dump = subprocess.run(
        [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=2000",
         f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", f"file://{tmp_path}/look.html"],
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    sizes = re.search(r'<pre id="r">([^<]+)</pre>', dump)
    assert sizes is not None, dump[-2000:]
    regions = [entry.split() for entry in sizes[1].split(";")]
    measured = {(width, name) for width, name, _ in regions}
    for name in ("parameters", "budget", "pose-table", "estimators", "correlations"):
        assert {("1280", name), ("1920", name)} <= measured
    # On a phone wide tables scroll; the page does not.
    assert ("390", "page") in measured
    assert [r for r in regions if int(r[-1]) > 0] == []


def test_page_compares_both_estimators(page, subject):
    paper = subject.solution.paper
    assert paper is not subject.implicit
    assert "implicit (chosen)" in page.text
    rows = page.rows("Identified parameters")
    assert number(rows[0][-1]) == pytest.approx(math.degrees(paper.x[0]), abs=1e-3)
    assert {row[0]: row[9] for row in rows} == subject.facts.data["side"]
    name, _, value, sigma, paper_value, paper_sigma, difference = page.rows("Both estimators")[0]
    assert name == "theta_off_1"
    assert number(value) == pytest.approx(math.degrees(subject.implicit.x[0]), abs=1e-3)
    assert number(paper_value) == pytest.approx(math.degrees(paper.x[0]), abs=1e-3)
    for shown, estimate in ((sigma, subject.implicit), (paper_sigma, paper)):
        expected = math.degrees(estimate.standard_deviation[0])
        assert number(shown) == pytest.approx(expected, rel=0.06)
    change = math.degrees(paper.x[0] - subject.implicit.x[0])
    assert number(difference) == pytest.approx(change, abs=1e-3)
    assert "Use implicit" in page.text


def test_joint_table_compares_with_stated_sigma(page, subject):
    stated = [
        # Two harmonics, backlash and sag of 0.01 deg each.
        *[math.radians(0.01) * 2.0 * 1e3] * 5,
        # Noise, gain over full scale, backlash and sag; then part of the linearity deviation.
        *[math.hypot(1.03, 0.005 * math.radians(120.0) / math.sqrt(12.0) * 1e3)] * 2,
    ]
    joints = page.rows("Joints:")
    for row, least in zip(joints[:5], stated[:5], strict=True):
        assert number(row[4]) == pytest.approx(least, rel=0.02)
    peak = 0.02 * math.radians(120.0) * 1e3
    for row, least in zip(joints[5:], stated[5:], strict=True):
        assert math.hypot(least, 0.25 * peak) < number(row[4]) < math.hypot(least, 0.5 * peak)
    for row in joints:
        assert number(row[6]) == pytest.approx(number(row[5]) / number(row[4]), rel=0.08)
        assert not row[6].startswith("▲")


def test_page_has_closure_before_after_and_held_out(page, subject):
    rows = {row[0]: [number(cell) for cell in row[1:]] for row in page.rows("Closure at")}
    for name, sigmas in (
        ("nominal, before", subject.solution.before),
        ("implicit (chosen), after", subject.solution.estimate.sigmas),
    ):
        position, orientation = sigmas.position_m, sigmas.orientation_rad
        figures = (position.rms, position.as_printed, orientation.rms, orientation.as_printed)
        assert rows[name] == pytest.approx([1e3 * figure for figure in figures], rel=1e-3)
    held_out = next(values for name, values in rows.items() if "held out" in name)
    sigmas = subject.checks.held_out.sigmas
    assert held_out[0] == pytest.approx(1e3 * sigmas.position_m.rms, rel=1e-3)
    assert held_out[2] == pytest.approx(1e3 * sigmas.orientation_rad.rms, rel=1e-3)


def test_page_lists_all_poses_and_joints(page, subject):
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
    assert [number(row[7]) for row in joints] == pytest.approx(low.tolist(), abs=0.006)


def test_page_has_rvdt_verdicts_and_condition(page, subject):
    assert len(subject.solution.rvdt) == 2
    assert page.rows("Corrections of RVDT readings")
    for verdict in subject.solution.rvdt:
        assert verdict.text in page.text
    rows = {row[0]: row[1:] for row in page.rows("How well the poses")}
    condition = subject.solution.identifiability.scaled_condition_number
    assert number(rows["scaled condition number"][0]) == pytest.approx(condition, rel=5e-3)
    assert "limit 100" in rows["scaled condition number"][1]
    assert rows["rank"] == ["14", "of 14"]
    indices = list(subject.facts.json["observability"].values())
    assert indices == pytest.approx(list(subject.solution.identifiability.observability))
    for chi2, small in ((0.099, True), (0.101, False)):
        adjudication = replace(subject.solution.adjudication, stated_chi2_per_dof=chi2)
        solution = replace(subject.solution, adjudication=adjudication)
        note = replace(subject, solution=solution).facts.table("determined").note
        assert ("below 0.1" in note) is small


def test_page_of_the_paper_estimator(folder, parse_page):
    subject = report_subject(folder, estimator="paper")
    page = parse_page(report_html(subject).decode())
    assert "paper (chosen)" in page.text
    # Student's interval: the noise is estimated from residuals.
    estimate = subject.solution.estimate
    row = page.rows("Identified parameters")[0]
    half = t.ppf(0.975, estimate.dof) * math.degrees(estimate.standard_deviation[0])
    assert number(row[7]) - number(row[6]) == pytest.approx(2.0 * half, rel=0.02)


def test_page_names_unsensed_joints(folder, parse_page):
    subject = report_subject(folder, unsensed_joints=(6, 7))
    page = parse_page(report_html(subject).decode())
    assert "The readings of joints 6 and 7 were not used" in page.text
    assert "theta_off_6" not in [row[0] for row in page.rows("Identified parameters")]
    assert "The paper's estimator, which needs every joint sensed" in page.text
    assert page.rows("Joints:")[5][1].endswith("(reading not used)")
