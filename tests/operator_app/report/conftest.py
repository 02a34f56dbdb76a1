"""What tests of reports look at: a session, what is reported of it, and its page taken apart.

Taking apart knows html.parser, and nothing of sarcal's markup.
"""

import re
from html.parser import HTMLParser

import pytest
import sarcal

from operator_app.headless.procedure_run import run
from operator_app.report.html.page import report_html
from operator_app.report.subject import Subject
from operator_app.session.store.journal import JOURNAL_NAME, read_journal
from operator_app.session.workflow.listener import Listener
from tests.oracles.panda import FOLDER as PANDA
from tests.oracles.reported_session import HOSTILE, subject_of
from tests.oracles.short_procedure import short_procedure

VOID = {"meta", "br", "col", "link", "hr", "img", "input"}


class Page(HTMLParser):
    """Tables, texts, attributes and nesting errors of a page."""

    def __init__(self, source: str) -> None:
        super().__init__(convert_charrefs=True)
        self.errors: list[str] = []
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.tables: list[dict[str, list[list[tuple[str, dict[str, str], str]]]]] = []
        self.text = ""
        self._open: list[str] = []
        self._part = ""
        self.feed(source)
        self.close()
        self.errors += [f"<{tag}> is never closed" for tag in self._open]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        names = [name for name, _ in attrs]
        if len(set(names)) != len(names):
            self.errors.append(f"<{tag}> has an attribute twice")
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        if tag not in VOID:
            self._open.append(tag)
        if tag == "table":
            self.tables.append({"caption": [], "thead": [], "tbody": []})
        elif tag in ("thead", "tbody", "caption"):
            self._part = tag
            if tag == "caption":
                self.tables[-1]["caption"].append([("caption", {}, "")])
        elif tag == "tr":
            self.tables[-1][self._part].append([])
        elif tag in ("th", "td"):
            found = {name: value or "" for name, value in attrs}
            self.tables[-1][self._part][-1].append((tag, found, ""))

    def handle_endtag(self, tag: str) -> None:
        if not self._open or self._open.pop() != tag:
            self.errors.append(f"</{tag}> closes something else")

    def handle_data(self, data: str) -> None:
        if "style" in self._open:
            return
        self.text += data
        if any(tag in self._open for tag in ("th", "td", "caption")):
            row = self.tables[-1][self._part][-1]
            tag, attrs, before = row[-1]
            row[-1] = (tag, attrs, before + data)

    def table(self, caption: str) -> dict[str, list[list[tuple[str, dict[str, str], str]]]]:
        """Return the one table whose caption begins so."""
        (found,) = [t for t in self.tables if t["caption"][0][0][2].startswith(caption)]
        return found

    def rows(self, caption: str) -> list[list[str]]:
        """Return the texts of a table's body."""
        return [[cell[2] for cell in row] for row in self.table(caption)["tbody"]]


def units_missing(page: Page, without_unit: set[str]) -> list[str]:
    """Columns of numbers whose header, group, caption or row gives no unit."""
    missing = []
    for table in page.tables:
        caption = table["caption"][0][0][2]
        headers = _headers(table["thead"])
        has_unit_column = any(title == "unit" for title, _ in headers)
        for column, (title, group) in enumerate(headers):
            numbers = [row[column] for row in table["tbody"] if row[column][1].get("class") == "n"]
            said = f"{title} {group} {caption}"
            if not numbers or has_unit_column or re.search(r"\[[^\]]+\]|no unit", said):
                continue
            if title not in without_unit:
                missing.append(f"{caption}: {title}")
    return missing


def _headers(rows: list[list[tuple[str, dict[str, str], str]]]) -> list[tuple[str, str]]:
    """Title and group of every column, from one or two header rows."""
    if len(rows) == 1:
        return [(cell[2], "") for cell in rows[0]]
    second = iter(rows[1])
    found = []
    for _, attrs, words in rows[0]:
        if attrs.get("rowspan"):
            found.append((words, ""))
        else:
            found += [(next(second)[2], words) for _ in range(int(attrs["colspan"]))]
    return found


@pytest.fixture(scope="session")
def hinge(reference_data):
    """The library's result from poses in a hinge."""
    poses = reference_data / "hinge/hinge_quantised.csv"
    return sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=poses)


@pytest.fixture(scope="session")
def ball():
    """And from a real arm's poses with a ball in six sockets."""
    poses = PANDA / "panda_1.csv"
    return sarcal.calibrate(
        arm="franka_panda", fixture="ball", poses=poses, drop_unidentifiable=True
    )


@pytest.fixture(scope="session")
def take_apart():
    """Parse a page."""
    return Page


@pytest.fixture
def find_missing_units():
    """Find columns without a unit."""
    return units_missing


@pytest.fixture(scope="session")
def recorded():
    """What tests of reports share: the journal is captured once and solved once."""
    return {}


@pytest.fixture
def folder(make_session, recorded, tmp_path):
    """A session of 16 poses on the virtual plant; one is excluded, one has a hostile note."""
    where = tmp_path / "session"
    if "hinge" in recorded:
        where.mkdir()
        (where / JOURNAL_NAME).write_bytes(recorded["hinge"])
        return where
    session = make_session(short_procedure(16, "datasheet"), "datasheet")
    run(session, Listener())
    session.exclude(4, "bumped the table <b>")
    session.note(7, HOSTILE.replace("\ud800", ""))
    session.check(session.calibrate())
    session.close("done")
    recorded["hinge"] = (where / JOURNAL_NAME).read_bytes()
    return where


@pytest.fixture
def subject(folder, recorded):
    if "subject" not in recorded:
        recorded["subject"] = subject_of(read_journal(folder).events)
    found = recorded["subject"]
    assert isinstance(found, Subject)
    return found


@pytest.fixture
def page(subject, take_apart):
    return take_apart(report_html(subject).decode())
