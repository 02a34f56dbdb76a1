"""Text, JSON, page, screen and plain words of one session say the same numbers, in the same units.

Every rendering is taken apart again by a parser of this file's own.
"""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import pytest

from operator_app.calibration.checks import check
from operator_app.calibration.judgement import Notice
from operator_app.calibration.solve import calibrate
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import load_poses
from operator_app.report.facts import Facts, facts_of
from operator_app.report.page_head import tiles
from operator_app.report.page_table import table_html
from operator_app.report.screen import headline_spans, table_spans
from operator_app.report.spans import Line
from operator_app.report.text import facts_text

NUMBER = re.compile(r"(?<![\w.])[-+\u2212]?\d+(?:\.\d+)?(?:e[-+]?\d+|·10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?(?![\w.])")
RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
TO_JSON = {"deg": 1.0, "mm": 1e-3}
"""Parameters are in deg and m in JSON."""


@pytest.fixture(scope="module")
def facts(reference_data: Path) -> Facts:
    arm, fixture = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
    poses = load_poses(reference_data / "hinge" / "hinge_rvdt1pct.csv").poses
    solution = calibrate(arm, fixture, poses)
    found = facts_of(solution, checks=check(solution, arm, fixture, poses))
    # A warning that is sure to be there, whatever this calibration is warned of.
    return dataclasses.replace(
        found, notices=(*found.notices, Notice(code="X", text="12.5 mm off"))
    )


def numbers(words: str) -> list[str]:
    """Numbers in a rendering, spelled as text spells them: digits and all."""
    return [
        re.sub(r"·10(.+)", lambda m: f"e{int(m[1].translate(RAISED)):+03d}", n).replace(
            "\u2212", "-"
        )
        for n in NUMBER.findall(words)
    ]


def plain(row: Line) -> str:
    return "".join(text for text, _ in row)


def text_rows(text: str, title: str, heads: int) -> list[str]:
    """Rows of the table under a title, without its head and its note."""
    lines = text.split(title + "\n", 1)[1].split("\n\n", maxsplit=1)[0].splitlines()
    indented = [line.strip() for line in lines if line.startswith("  ")]
    return indented[heads:]


def test_every_table_has_the_same_numbers_as_text_on_the_page_and_on_the_screen(
    facts: Facts, take_apart: type
) -> None:
    text = facts_text(facts)
    for table in facts.tables:
        page = take_apart(table_html(table))
        body = [[cell[2] for cell in row] for row in page.tables[0]["tbody"]]
        on_screen = [numbers(plain(row)) for row in table_spans(table)[1]]
        kept = [k for k, column in enumerate(table.columns) if not column.detail]
        if any(column.summary for column in table.columns):
            # The screen names the largest of what the page lists, e.g. "RVDT curve 6 46 %".
            for few, listed in zip(on_screen, body, strict=True):
                assert set(few) <= {*numbers(" ".join(listed)), "6", "7"}
            on_page = on_screen
        else:
            on_page = [numbers(" ".join(row[k] for k in kept)) for row in body]
            assert on_screen == on_page
        assert sum(map(len, on_page)) >= len(body), table.ident
        if not table.detail:
            heads = len(page.tables[0]["thead"])
            in_text = [numbers(row) for row in text_rows(text, table.title, heads)]
            assert in_text == on_page, table.ident


def test_parameters_in_json_are_those_of_the_table_to_its_last_digit(
    facts: Facts, take_apart: type
) -> None:
    found = facts.json
    page = take_apart(table_html(facts.tables[0]))
    titles = [cell[2] for cell in page.tables[0]["thead"][0][:3]]
    titles += [cell[2] for cell in page.tables[0]["thead"][1]]
    assert titles[:9] == [
        "parameter", "unit", "nominal", "identified", "change", "sigma", "type A", "95 % from", "to",
    ]  # fmt: skip
    names = []
    for row in page.tables[0]["tbody"]:
        name, unit, *cells = [cell[2].replace("\u2212", "-") for cell in row]
        names.append(name)
        keys = [
            found["nominal"][name], found["parameters"][name], None, found["sigma"][name],
            found["repeatability"][name], *found["interval_95"][name],
        ]  # fmt: skip
        for cell, value in zip(cells, keys, strict=False):
            if value is not None:
                last = 10.0 ** -len(cell.partition(".")[2])
                assert TO_JSON[unit] * float(cell) == pytest.approx(
                    value, abs=0.5001 * last * TO_JSON[unit]
                )
    assert names == list(found["parameters"])


def test_the_dh_table_is_in_one_unit_and_agrees_with_the_parameters(facts: Facts) -> None:
    dh = facts.table("dh")
    assert dh is not None
    head = [plain(row) for row in table_spans(dh)[0]]
    assert re.findall(r"\[(.+?)\]", head[0]) == ["mm", "mm", "deg", "deg"]
    text = text_rows(facts_text(facts), dh.title, 2)
    for row in text_rows(facts_text(facts), facts.tables[0].title, 2):
        name, identified = row.split()[0], row.split()[3]
        link = int(name.rpartition("_")[2])
        assert identified in text[link].split()


def test_headlines_are_the_same_in_tiles_lines_and_tables(facts: Facts, take_apart: type) -> None:
    page = take_apart(tiles(facts))
    line = plain(headline_spans(facts.headlines, 1000))
    assert numbers(line) == numbers(" ".join(f"{h.figure.shown} {h.note}" for h in facts.headlines))
    for headline in facts.headlines:
        said = f"{headline.name}{headline.figure.with_unit}"
        assert said.replace(" ", "") in page.text.replace(" ", "").replace("\u2212", "-")
    rows = text_rows(facts_text(facts), "How well the poses determine them (no unit)", 1)
    for name in ("rank", "poses", "chi2/dof", "scaled condition number"):
        (row,) = [r for r in rows if r.startswith(f"{name}  ")]
        assert facts.headline(name).figure.shown in numbers(row)
    assert facts.json["scaled_condition_number"] == pytest.approx(
        float(facts.headline("scaled condition number").figure.shown), rel=5e-3
    )
    assert facts.json["rank"] == int(facts.headline("rank").figure.shown)


def test_a_notice_is_in_every_rendering_once(facts: Facts) -> None:
    for notice in facts.notices:
        joined = " ".join(facts_text(facts).split())
        assert joined.count(" ".join(notice.text.split())) == 1
    listed = [(n["code"], n["text"]) for n in facts.json["warnings"]]
    assert listed == [(n.code, n.text) for n in facts.notices][:-1]


def test_headlines_too_long_for_a_line_lose_their_notes_and_no_figure(facts: Facts) -> None:
    short = plain(headline_spans(facts.headlines, 60))
    assert "before" not in short
    for headline in facts.headlines:
        assert headline.figure_text in short
