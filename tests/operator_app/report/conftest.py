"""One session to report, and a reader of report pages that shares no code with their writer."""

import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest

from operator_app.commands.run import run
from operator_app.report.html.page import report_html
from operator_app.report.subject import Subject, subject_of_session
from operator_app.session.store.journal import read_journal
from operator_app.session.store.replay import replay
from operator_app.session.store.stored_calibration import session_calibration, with_checks
from operator_app.session.workflow.listener import Listener
from tests.oracles.plant_arm import SERIAL, PlantArm
from tests.oracles.plant_sessions import TickingClock, opened, short_procedure

HOSTILE = '<script>alert("1")</script></td></table>\u202e & \x07\ud800'


def report_subject(folder: Path, **options: Any) -> Subject:
    """Subject of the report of a session, as in `sarcal report`."""
    contents, procedure = read_journal(folder), short_procedure(16, "datasheet")
    state = replay(contents.events)
    checked = with_checks(session_calibration(state, procedure, **options), state, procedure)
    return subject_of_session(folder, contents, procedure, checked)


def number(words: str) -> float:
    return float(words.replace("\u2212", "-"))


def at(element: ET.Element, name: str) -> float:
    """A coordinate or size of an element of SVG."""
    return float(element.get(name, "nan"))


class Page:
    """Tags, attributes, tables and text of a page, which must be well-formed as XML but for void elements."""

    def __init__(self, source: str) -> None:
        body = re.sub(r"<(meta|br|col|link|hr)\b([^>]*)>", r"<\1\2/>", source)
        root = ET.fromstring(f"<root>{body.removeprefix('<!DOCTYPE html>')}</root>")  # noqa: S314
        elements = list(root.iter())[1:]
        self.tags = [e.tag for e in elements]
        self.attributes = [(e.tag, name, value) for e in elements for name, value in e.items()]
        for style in root.iter("style"):
            style.text = ""
        self.text = "".join(root.itertext())
        self.tables = [
            {"caption": "".join(table.find("caption").itertext())}
            | {
                part: [_cells(row) for row in table.findall(f"{part}/tr")]
                for part in ("thead", "tbody")
            }
            for table in root.iter("table")
        ]

    def table(self, caption: str) -> dict[str, list[list[tuple[str, dict[str, str], str]]]]:
        """The one table whose caption starts so: its caption, thead and tbody."""
        (table,) = [t for t in self.tables if t["caption"].startswith(caption)]
        return table

    def rows(self, caption: str) -> list[list[str]]:
        return [[text for _, _, text in row] for row in self.table(caption)["tbody"]]


def _cells(row: ET.Element) -> list[tuple[str, dict[str, str], str]]:
    return [(cell.tag, dict(cell.items()), "".join(cell.itertext())) for cell in row]


@pytest.fixture(scope="session")
def parse_page():
    return Page


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """A session of 16 poses on the virtual plant; one is excluded, one has a hostile note."""
    folder = tmp_path_factory.mktemp("report") / "session"
    procedure = short_procedure(16, "datasheet")
    arm = PlantArm(procedure, "datasheet", SERIAL)
    session = opened(folder, arm, procedure, clock=TickingClock())
    run(session, Listener())
    session.exclude(4, "bumped the table <b>")
    session.note(7, HOSTILE.replace("\ud800", ""))
    session.check(session.calibrate())
    session.close("done")
    return folder


@pytest.fixture(scope="session")
def subject(folder):
    return report_subject(folder)


@pytest.fixture(scope="session")
def html(subject):
    return report_html(subject).decode()


@pytest.fixture(scope="session")
def page(html, parse_page):
    return parse_page(html)
