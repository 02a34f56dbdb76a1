"""The report page: complete, self-contained, and safe against hostile text."""

import json
import re
import shutil
import subprocess
from dataclasses import replace

import pytest

from operator_app.calibration.tool_accuracy import TrueErrors
from operator_app.report.html.page import report_html
from operator_app.session.store.journal import read_journal
from tests.operator_app.report.conftest import HOSTILE, report_subject

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


def test_page_is_well_formed_self_contained_and_reproducible(page, subject, folder):
    source = report_html(subject).decode()
    assert report_html(report_subject(read_journal(folder).events)).decode() == source
    assert not {"script", "img", "link", "iframe", "object", "form", "input"} & set(page.tags)
    assert re.findall(r"https?:|url\(|@import", source) == []
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


def test_hostile_notes_stay_text(page, subject):
    source = report_html(subject).decode()
    assert "alert(" in page.text
    assert "<script" not in source
    poses = page.rows("Captured poses")
    assert poses[6][-1].startswith('<script>alert("1")</script></td></table>')
    assert "\x07" not in source
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


def test_page_head_names_arm_fixture_and_time(page, subject):
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


def test_page_head_has_true_errors_of_a_simulation(subject):
    truth = TrueErrors(inside_95=13, of=14, tool_rms_m=0.00031, predicted_rms_m=0.00042)
    simulated = replace(subject, solution=replace(subject.solution, truth=truth))
    head = report_html(simulated).decode().partition("<main")[0]
    assert (
        "The truth: 13 of 14 entries within their 95 % intervals; tool off by 0.31 mm rms" in head
    )
    assert "The truth" not in report_html(subject).decode()


def test_notes_of_an_accepted_result_are_not_warnings(subject):
    accepted = report_html(subject).decode()
    assert subject.facts.verdict == "accepted"
    assert 'class="warnings notes"' in accepted
    assert " warning<" not in accepted
    refused = replace(subject, solution=replace(subject.solution, reasons=("too far off",)))
    assert 'class="warnings"' in report_html(refused).decode()


@pytest.mark.campaign
@pytest.mark.skipif(BROWSER is None, reason="needs Chromium")
def test_browser_clips_no_table(subject, tmp_path):
    page = report_html(subject).decode()
    page = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page)
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


def test_page_head_has_verdict_widest_sigma_and_tool(subject):
    head, _, rest = report_html(subject).decode().partition("<main")
    assert head.index("<h1") < head.index("Widest sigma") < head.index("hand-before")
    assert head.index("hand-before") < head.index("hand-after") < head.index('class="tiles"')
    assert "To halve it: " in head
    assert "hand-before" not in rest
    assert 'id="warnings"' in rest
