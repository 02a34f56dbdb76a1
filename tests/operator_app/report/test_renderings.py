"""One journalled session says the same numbers in text, JSON, page and on the screen, in the same units.

Text and JSON are what `sarcal report` prints, the page is the file it writes, the screen is what the
app shows when it resumes the session. Every rendering is taken apart by a parser of this file's own.
"""

import json
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from typing import Any

import pytest

from operator_app.cli import main
from operator_app.report.facts import Facts
from operator_app.report.spans import Line
from operator_app.report.subject import facts_on
from operator_app.report.table import FactTable
from operator_app.report.text import headline_spans, table_spans
from operator_app.session.ui.operations import Operations
from operator_app.units import Figure
from tests.oracles.journalled_sessions import Quiet, opened_again

NUMBER = re.compile(r"(?<![\w.])[-+\u2212]?\d+(?:\.\d+)?(?:e[-+]?\d+|·10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?(?![\w.])")
RAISED = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
PARAMETERS = {
    "nominal", "parameters", "sigma", "interval_95", "repeatability", "tolerated_parameters",
    "jackknife_sigma",
}  # fmt: skip
"""What JSON gives in deg and m; everything else is in the unit that people read."""


@dataclass(frozen=True)
class Renderings:
    """What was printed, written and shown of one session."""

    text: str
    data: Mapping[str, Any]
    page: Any
    facts: Facts
    """On the screen."""


@pytest.fixture(scope="module")
def said(journalled, tmp_path_factory, take_apart):
    folder = tmp_path_factory.mktemp("renderings") / "run"
    shutil.copytree(journalled["run"], folder)
    assert main(["report", str(folder)]) == 0
    session = opened_again(folder)
    publisher = Quiet(session)
    Operations(session, publisher).connect()
    session.close("left")
    facts = facts_on(publisher.shown)
    assert facts is not None
    return Renderings(
        text=printed("report", str(folder), "--text"),
        data=json.loads(printed("report", str(folder), "--json")),
        page=take_apart((folder / "report.html").read_text()),
        facts=facts,
    )


def printed(*arguments: str) -> str:
    with redirect_stdout(StringIO()) as out:
        assert main(list(arguments)) == 0
    return out.getvalue()


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


def body_of(said: Renderings, table: FactTable) -> list[list[str]]:
    return [[cell[2] for cell in row] for row in said.page.table(typeset(table.title))["tbody"]]


def typeset(title: str) -> str:
    return title.replace("-1 to", "\u22121 to")


def test_tables_agree_in_text_page_and_screen(said):
    assert {t.ident for t in said.facts.tables} >= {
        "parameters", "dh", "hand", "determined", "closure", "noise", "budget", "halving", "tolerated", "tests",
        "observability", "correlations",
    }  # fmt: skip
    for table in said.facts.tables:
        body = body_of(said, table)
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
            heads = len(said.page.table(typeset(table.title))["thead"])
            in_text = [numbers(row) for row in text_rows(said.text, table.title, heads)]
            assert in_text == on_page, table.ident


def figures_of(said: Renderings) -> Iterator[tuple[tuple[str | int, ...], str, str]]:
    """Every number of the page that JSON has too: where it stands there, its unit, its digits."""
    for table in said.facts.tables:
        columns = [k for k, c in enumerate(table.columns) if not c.summary]
        for row, shown in zip(table.rows, body_of(said, table), strict=True):
            cells = [row[k] for k in columns]
            unit = row[1] if table.columns[1].title == "unit" else ""
            for k, cell, words in zip(columns, cells, shown, strict=True):
                if isinstance(cell, Figure) and cell.key:
                    own = re.search(r"\[(.+?)\]", f"{_header(table, k)} {table.title}")
                    here = unit if isinstance(unit, str) and unit else own[1] if own else ""
                    yield cell.key, here, words


def _header(table: FactTable, k: int) -> str:
    column = table.columns[k]
    return f"{column.title} {column.group} " + (f"[{column.unit}]" if column.unit else "")


def to_json(key: tuple[str | int, ...], unit: str) -> float:
    """What the number on the page is to be multiplied by."""
    if PARAMETERS & {*key} and unit == "mm":
        return 1e-3
    return 1e-2 if unit == "%" else 1.0


def test_table_numbers_agree_with_json(said):
    compared, seen = 0, set()
    for key, unit, words in figures_of(said):
        value: Any = said.data
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
    # Each of these is a contract.
    assert seen >= {
        "nominal", "parameters", "sigma", "repeatability", "interval_95", "tip_sigma_mm", "rank",
        "scaled_condition_number", "condition_number", "chi2_per_dof", "stated_chi2_per_dof", "poses",
        "dof", "iterations", "sigma_pos_mm", "sigma_ori_mrad", "before", "checks", "budget",
        "halved",
        "variance_components", "variance_components_interval", "tolerated_parameters",
        "observability",
    }  # fmt: skip


def test_tests_and_correlations_agree_with_json(said):
    tests = said.facts.table("tests")
    assert tests is not None
    for row, found in zip(body_of(said, tests), said.data["tests"], strict=True):
        assert row[0] == found["code"]
        for words, name in zip(row[1:], ("statistic", "threshold", "false_alarm"), strict=True):
            shown = numbers(words)
            assert [float(n) for n in shown] == (
                [] if found[name] is None else [pytest.approx(found[name], rel=6e-3)]
            )
    correlations = said.facts.table("correlations")
    assert correlations is not None
    for k, row in enumerate(body_of(said, correlations)):
        shown = [float(n) for n in numbers(" ".join(row[1:]))]
        assert shown == pytest.approx(said.data["correlations"][k][: k + 1], abs=0.00501)


def test_dh_table_agrees_with_the_parameters(said):
    dh = said.facts.table("dh")
    assert dh is not None
    head = [plain(row) for row in table_spans(dh)[0]]
    assert re.findall(r"\[(.+?)\]", head[0]) == ["mm", "mm", "deg", "deg"]
    text = text_rows(said.text, dh.title, 2)
    for row in text_rows(said.text, said.facts.tables[0].title, 2):
        name, identified = row.split()[0], row.split()[3]
        link = int(name.rpartition("_")[2])
        assert identified in text[link].split()


def test_headlines_agree_in_tiles_lines_and_tables(said):
    headlines = said.facts.headlines
    line = plain(headline_spans(headlines, 1000))
    assert numbers(line) == numbers(" ".join(f"{h.figure.shown} {h.note}" for h in headlines))
    for headline in headlines:
        told = f"{headline.name}{headline.figure.with_unit}"
        assert told.replace(" ", "") in said.page.text.replace(" ", "").replace("\u2212", "-")
    rows = text_rows(said.text, "How well the poses determine them (no unit)", 1)
    for name in ("rank", "poses", "chi2/dof", "scaled condition number"):
        (row,) = [r for r in rows if r.startswith(f"{name}  ")]
        assert {h.name: h for h in headlines}[name].figure.shown in numbers(row)


def test_notices_are_in_every_rendering_once(said):
    assert said.facts.notices
    assert [(n["code"], n["text"]) for n in said.data["warnings"]] == [
        (n.code, n.sentence) for n in said.facts.notices
    ]
    for notice in said.facts.notices:
        once = " ".join(notice.sentence.split())
        assert " ".join(said.text.split()).count(once) == 1
        assert once in " ".join(said.page.text.split())


def test_json_of_run_app_and_resumed_sessions_agree(journalled, said):
    """The JSON of the session that ran, of the one that resumed it, and of the app are one."""
    mine = {k: v for k, v in said.data.items() if k != "session"}
    for made in ("run", "app", "resumed"):
        other = json.loads(printed("report", str(journalled[made]), "--json"))
        assert other.pop("session")["serial_number"] == "SDA-0001"
        assert other == mine


def test_short_headlines_omit_notes_only(said):
    short = plain(headline_spans(said.facts.headlines, 60))
    assert "before" not in short
    for headline in said.facts.headlines:
        assert headline.figure_text in short
