"""One session has the same numbers and units in text, JSON, page and on the screen.

Text and JSON are printed by `sarcal report`, the page is written by it, the screen is that of the resumed session.
A ball's loops give no orientation: null in JSON, "n/a" in texts.
"""

import json
import re
import shutil
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from types import SimpleNamespace
from typing import Any

import pytest
import sarcal

from operator_app.cli import main
from operator_app.report.facts import estimate_json, facts_of
from operator_app.report.results.verification import verification_text, verified_words
from operator_app.report.spans import Line
from operator_app.report.subject import facts_on
from operator_app.report.table import FactTable
from operator_app.report.text import facts_text, headline_spans, table_spans, verdict_text
from operator_app.session.ui.operations import Operations
from operator_app.units import CHI2, CONDITION, Figure
from tests.oracles.journalled_sessions import Quiet, resume_on_plant
from tests.oracles.story import story, with_condition_above

NUMBER = re.compile(r"(?<![\w.])[-+\u2212]?\d+(?:\.\d+)?(?:e[-+]?\d+|·10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?(?![\w.])")
RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
PARAMETERS = {
    "nominal", "parameters", "sigma", "interval_95", "repeatability", "tolerated_parameters",
    "jackknife_sigma",
}  # fmt: skip
"""Keys of JSON with values in deg and m; all others are in the displayed unit."""


@pytest.fixture(scope="module")
def renderings(journalled, tmp_path_factory, parse_page):
    """Outputs of one session; `facts` are those on the screen."""
    folder = tmp_path_factory.mktemp("renderings") / "run"
    shutil.copytree(journalled["run"], folder)
    assert main(["report", str(folder)]) == 0
    session = resume_on_plant(folder)
    publisher = Quiet(session)
    Operations(session, publisher).connect()
    session.close("left")
    return SimpleNamespace(
        text=printed("report", str(folder), "--text"),
        data=json.loads(printed("report", str(folder), "--json")),
        page=parse_page((folder / "report.html").read_text()),
        facts=facts_on(publisher.shown),
    )


def printed(*arguments: str) -> str:
    with redirect_stdout(StringIO()) as out:
        assert main(list(arguments)) == 0
    return out.getvalue()


def numbers(words: str) -> list[str]:
    """Numbers of a rendering, in the notation of plain text."""
    return [
        re.sub(r"·10(.+)", lambda m: f"e{int(m[1].translate(RAISED)):+03d}", n).replace(
            "\u2212", "-"
        )
        for n in NUMBER.findall(words)
    ]


def plain(row: Line) -> str:
    return "".join(text for text, _ in row)


def text_rows(text: str, title: str, heads: int) -> list[str]:
    """Rows of the table under a title, without heading and note."""
    lines = text.split(title + "\n", 1)[1].split("\n\n", maxsplit=1)[0].splitlines()
    return [line.strip() for line in lines if line.startswith("  ")][heads:]


def body_of(renderings: SimpleNamespace, table: FactTable) -> list[list[str]]:
    return [
        [cell[2] for cell in row] for row in renderings.page.table(typeset(table.title))["tbody"]
    ]


def typeset(title: str) -> str:
    return title.replace("-1 to", "\u22121 to")


def test_tables_agree_in_text_page_and_screen(renderings):
    assert {t.ident for t in renderings.facts.tables} >= {
        "parameters", "dh", "hand", "determined", "closure", "noise", "budget", "halving", "tolerated", "tests",
        "correlations",
    }  # fmt: skip
    for table in renderings.facts.tables:
        body = body_of(renderings, table)
        on_screen = [numbers(plain(row)) for row in table_spans(table)[1]]
        displayed = [k for k, column in enumerate(table.columns) if not column.detail]
        if any(column.summary for column in table.columns):
            # The screen names the largest entries of the page.
            for few, listed in zip(on_screen, body, strict=True):
                assert set(few) <= {*numbers(" ".join(listed)), "6", "7"}
            on_page = on_screen
        else:
            on_page = [numbers(" ".join(row[k] for k in displayed)) for row in body]
            assert on_screen == on_page
        assert sum(map(len, on_page)) >= len(body), table.ident
        if not table.detail:
            heads = len(renderings.page.table(typeset(table.title))["thead"])
            in_text = [numbers(row) for row in text_rows(renderings.text, table.title, heads)]
            assert in_text == on_page, table.ident


def figures_of(renderings: SimpleNamespace) -> Iterator[tuple[tuple[str | int, ...], str, str]]:
    """Numbers of the page that JSON has too: key, unit, digits."""
    for table in renderings.facts.tables:
        columns = [(k, c) for k, c in enumerate(table.columns) if not c.summary]
        for row, shown in zip(table.rows, body_of(renderings, table), strict=True):
            of_row = [row[1]] if table.columns[1].title == "unit" and row[1] else []
            for (k, column), words in zip(columns, shown, strict=True):
                if isinstance(row[k], Figure) and row[k].key:
                    header = f"{column.title} {column.group} [{column.unit}] {table.title}"
                    units = of_row or re.findall(r"\[([^\[\]]+)\]", header)
                    yield row[k].key, (*units, "")[0], words


def to_json(key: tuple[str | int, ...], unit: str) -> float:
    """The factor from the page to JSON."""
    if PARAMETERS & {*key} and unit == "mm":
        return 1e-3
    return 1e-2 if unit == "%" else 1.0


def test_table_numbers_agree_with_json(renderings):
    compared, seen = 0, set()
    for key, unit, words in figures_of(renderings):
        value: Any = renderings.data
        for step in key:
            value = value[step]
        (number,) = numbers(words) or [""]
        if value is None:
            assert words == "n/a"
            continue
        scale = to_json(key, unit)
        mantissa, _, power = number.partition("e")
        last = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
        assert scale * float(number) == pytest.approx(value, abs=0.5001 * last * scale), key
        compared += 1
        seen.add(key[0])
    assert compared > 250
    assert seen >= {
        "nominal", "parameters", "sigma", "repeatability", "interval_95", "tip_sigma_mm", "rank",
        "scaled_condition_number", "condition_number", "chi2_per_dof", "stated_chi2_per_dof", "poses",
        "dof", "iterations", "sigma_pos_mm", "sigma_ori_mrad", "before", "checks", "budget",
        "halved",
        "variance_components", "variance_components_interval", "tolerated_parameters",
    }  # fmt: skip


def test_tests_and_correlations_agree_with_json(renderings):
    tests = renderings.facts.table("tests")
    for row, entry in zip(body_of(renderings, tests), renderings.data["tests"], strict=True):
        assert row[0] == entry["code"]
        for words, name in zip(row[1:], ("statistic", "threshold", "false_alarm"), strict=True):
            shown = numbers(words)
            assert [float(n) for n in shown] == (
                [] if entry[name] is None else [pytest.approx(entry[name], rel=6e-3)]
            )
    correlations = renderings.facts.table("correlations")
    for k, row in enumerate(body_of(renderings, correlations)):
        shown = [float(n) for n in numbers(" ".join(row[1:]))]
        assert shown == pytest.approx(renderings.data["correlations"][k][: k + 1], abs=0.00501)


def test_dh_table_agrees_with_the_parameters(renderings):
    dh = renderings.facts.table("dh")
    head = [plain(row) for row in table_spans(dh)[0]]
    assert re.findall(r"\[(.+?)\]", head[0]) == ["mm", "mm", "deg", "deg"]
    text = text_rows(renderings.text, dh.title, 2)
    for row in text_rows(renderings.text, renderings.facts.tables[0].title, 2):
        name, identified = row.split()[0], row.split()[3]
        link = int(name.rpartition("_")[2])
        assert identified in text[link].split()


def test_headlines_agree_in_tiles_lines_and_tables(renderings):
    headlines = renderings.facts.headlines
    line = plain(headline_spans(headlines, 1000))
    assert numbers(line) == numbers(" ".join(f"{h.figure.shown} {h.note}" for h in headlines))
    for headline in headlines:
        tile = f"{headline.name}{headline.figure.with_unit}"
        assert tile.replace(" ", "") in renderings.page.text.replace(" ", "").replace("\u2212", "-")
    rows = text_rows(renderings.text, "How well the poses determine the parameters (no unit)", 1)
    for name in ("rank", "poses", "chi2/dof", "scaled condition number"):
        (row,) = [r for r in rows if r.startswith(f"{name}  ")]
        assert {h.name: h for h in headlines}[name].figure.shown in numbers(row)


def test_notices_are_in_every_rendering_once(renderings):
    assert renderings.facts.solution.warnings
    assert [(n["code"], n["text"]) for n in renderings.data["warnings"]] == [
        (n.code, n.sentence) for n in renderings.facts.solution.warnings
    ]
    for notice in renderings.facts.solution.warnings:
        once = " ".join(notice.sentence.split())
        assert " ".join(renderings.text.split()).count(once) == 1
        assert once in " ".join(renderings.page.text.split())


def test_json_of_run_app_and_resumed_sessions_agree(journalled, renderings):
    expected = {k: v for k, v in renderings.data.items() if k != "session"}
    for name in ("run", "app", "resumed"):
        other = json.loads(printed("report", str(journalled[name]), "--json"))
        assert other.pop("session")["serial_number"] == "SDA-0001"
        assert other == expected


def test_short_headlines_omit_notes_only(renderings):
    short = plain(headline_spans(renderings.facts.headlines, 60))
    assert "before" not in short
    for headline in renderings.facts.headlines:
        assert headline.figure_text in short


def test_exceeded_condition_number_is_in_the_sentence_of_the_verdict():
    """It does not change the verdict, so no rendering may say only that the limits are met."""
    s = with_condition_above(story()["solved"], 20.0)
    facts, number = facts_on(s), s.solution.identifiability.scaled_condition_number
    assert (facts.solution.accepted, facts.verdict) == (True, "accepted")
    verdict = " ".join(verdict_text(facts).split())
    assert f"but its scaled condition number {CONDITION(number).shown} is above 20" in verdict
    assert "but" not in verdict_text(facts_on(story()["solved"]))


UNKNOWN = {"rms": None, "as_printed": None}


@pytest.fixture(scope="module")
def calibrated():
    """A result, and new poses of the same arm."""
    ball = {"arm": "sarcos_dextrous", "fixture": "sarcos_ball"}
    q_rad = sarcal.simulate(**ball, poses=30, seed=1).poses.q_rad
    made_from, new = sarcal.poses_of(q_rad=q_rad[:22]), sarcal.poses_of(q_rad=q_rad[22:])
    return sarcal.calibrate(**ball, poses=made_from, drop_unidentifiable=True), new


def test_json_has_null_orientation(calibrated):
    solution = calibrated[0]._subject.solution
    document = facts_of(solution).json
    for part in (document, document["before"], estimate_json(solution.paper)):
        assert part["sigma_ori_mrad"] == UNKNOWN
        assert part["sigma_pos_mm"]["rms"] > 0.0


def test_text_and_screen_show_no_orientation(calibrated):
    facts = facts_of(calibrated[0]._subject.solution)
    table = facts.table("closure")
    _, body = table_spans(table)
    screen = ["".join(words for words, _ in spans) for spans in body]
    for lines in (facts_text(facts).splitlines(), screen):
        closures = [x for x in lines if "n/a" in x and re.search("before|after|comparison", x)]
        assert len(closures) == len(table.rows)
        assert all(line.count("n/a") == 2 for line in closures)


def test_verification_uses_positions_only(calibrated):
    verification = sarcal.verify(*calibrated)
    rows = [row for row in str(verification).splitlines() if "  calibrated" in row]
    assert [row.split()[-2:] for row in rows] == 3 * [["n/a", "n/a"]]
    data = verification.to_json()
    assert data["with_best_table"]["sigma_pos_mm"]["rms"] > 0.0
    assert data["with_corrections"]["sigma_ori_mrad"] == UNKNOWN
    assert re.search(r": [\d.]+ mm rms, chi2", verified_words(verification._result))
    hinge = story()["verified"].verification
    assert re.search(r": [\d.]+ mm, [\d.]+ mrad rms, chi2", verified_words(hinge))
    assert data["sigma_ori_mrad"] == data["nominal"]["sigma_ori_mrad"] == UNKNOWN
    learned = replace(hinge.verification, chi2=replace(hinge.verification.chi2, high=0.0))
    text = verification_text(replace(hinge, verification=learned), calibrated[1], "")
    assert f"exceeds {CHI2(hinge.stated.high).shown}." in " ".join(text.split())
