"""The fault table: help and manual print all of it, and its messages are ones that the program can print."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from hardware.virtual.fault_messages import FAULTS, OPERATOR_SIDE
from hardware.virtual.faults import FAULT_ACTIONS
from operator_app.manual.code_pages import faults_page

REPOSITORY = Path(__file__).resolve().parents[2]
GAP = "\0"
"""Stands for a value in a message."""


def messages(*folders: str) -> Iterator[str]:
    """Yield every string in these packages in lower case, except those of the table itself."""
    for path in (path for folder in folders for path in (REPOSITORY / folder).rglob("*.py")):
        if path.name == "fault_messages.py":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.JoinedStr):
                parts = (p.value if isinstance(p, ast.Constant) else GAP for p in node.values)
                yield "".join(map(str, parts)).lower()
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                # Templates of operator_app/messages: {certain:drifts|may drift}, {joint}.
                certain = re.sub(r"\{certain:([^|}]*)\|[^}]*\}", r"\1", node.value)
                yield re.sub(r"\{[^}]*\}", GAP, certain).lower()


def test_help_prints_a_row_for_every_fault(run_command):
    simulated = (REPOSITORY / "hardware/virtual").glob("[!f]*.py")
    read = {kind for path in simulated for kind in FAULTS if f'"{kind}" ' in path.read_text()}
    assert FAULTS.keys() == FAULT_ACTIONS.keys() | read
    assert all(row.texts or not row.always_reported for row in FAULTS.values())
    printed = run_command(0, "controller", "--fault", "help").words
    for kind, row in FAULTS.items():
        arm = f"arm {row.does()} kept {row.kept}"
        text = f"{kind} broken {row.broken} you see {row.symptom()} {arm} do {row.remedy}"
        assert " ".join(text.split()) in printed


def test_program_can_print_every_message_of_the_table():
    printable = list(messages("hardware", "operator_app"))
    for kind, row in {**FAULTS, **OPERATOR_SIDE}.items():
        for message in row.texts:
            pattern = "".join(
                f"(?:{piece}|{GAP})" if piece.isdigit() else re.escape(piece)
                for piece in re.split(r"([0-9]+)", message.replace("{joint}", GAP).lower())
            )
            assert any(re.search(pattern, text) for text in printable), (kind, message)


def test_manual_page_has_reaction_and_kept_data_of_every_row():
    page = faults_page()
    assert page.count("| the arm | what is kept |") == 2
    for row in (*FAULTS.values(), *OPERATOR_SIDE.values()):
        assert row.kept in page
        assert row.does() in page
