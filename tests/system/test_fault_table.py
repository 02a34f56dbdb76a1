"""The table of faults: `--fault help` prints all of it, and the program can say what it says that it says."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from hardware.virtual.fault_messages import FAULTS, OPERATOR_SIDE
from operator_app.manual.code_pages import faults_page

REPOSITORY = Path(__file__).resolve().parents[2]
GAP = "\0"
"""Stands for a value in a sentence."""


def strings_of(*folders: str) -> Iterator[str]:
    """Every sentence written in these packages, but for the table itself."""
    for folder in folders:
        for path in sorted((REPOSITORY / folder).rglob("*.py")):
            if path.name == "fault_messages.py":
                continue
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.JoinedStr):
                    yield "".join(
                        str(part.value) if isinstance(part, ast.Constant) else GAP
                        for part in node.values
                    ).lower()
                elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                    # Templates of operator_app/messages: {certain:drifts|may drift}, {joint}.
                    certain = re.sub(r"\{certain:([^|}]*)\|[^}]*\}", r"\1", node.value)
                    yield re.sub(r"\{[^}]*\}", GAP, certain).lower()


def test_every_fault_is_told_by_help_with_what_is_seen_and_what_to_do(ends_with):
    said = ends_with(0, "controller", "--fault", "help").words
    for kind, words in FAULTS.items():
        arm = f"arm {words.does()} kept {words.kept}"
        row = f"{kind} broken {words.broken} you see {words.symptom()} {arm} do {words.remedy}"
        assert " ".join(row.split()) in said


def test_what_the_table_says_is_what_the_program_can_say():
    sentences = list(strings_of("hardware", "operator_app"))
    for kind, words in {**FAULTS, **OPERATOR_SIDE}.items():
        for part in words.texts:
            pattern = "".join(
                f"(?:{piece}|{GAP})" if piece.isdigit() else re.escape(piece)
                for piece in re.split(r"([0-9]+)", part.replace("{joint}", GAP).lower())
            )
            assert any(re.search(pattern, text) for text in sentences), (kind, part)


def test_the_manual_says_what_the_arm_does_and_what_is_kept_of_both_sides():
    page = faults_page()
    assert page.count("| the arm | what is kept |") == 2
    for words in (*FAULTS.values(), *OPERATOR_SIDE.values()):
        assert words.kept in page
        assert words.does() in page
