"""The report of the session that is open: its page, from its journal. Knows no widget and solves nothing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from operator_app.config.atomic import write_atomically
from operator_app.errors import GuardError
from operator_app.report.html.page import report_html
from operator_app.report.subject import subject_of_session
from operator_app.session.store.journal import read_journal
from operator_app.session.store.stored_calibration import StoredCalibration, recorded

if TYPE_CHECKING:
    from operator_app.session.workflow.session import Session

REPORT_NAME = "report.html"


def write_report(session: Session) -> Path:
    """Write the page into the session's folder, from its journal."""
    found = recorded(session.state)
    if not isinstance(found, StoredCalibration):
        raise GuardError("There is no calibration of these poses", "Calibrate first (step 5)")
    folder = session.journal.path.parent
    contents = read_journal(folder)
    subject = subject_of_session(
        folder.resolve().name, contents.events, session.procedure, found, torn=contents.torn
    )
    target = folder / REPORT_NAME
    write_atomically(target, report_html(subject))
    return target
