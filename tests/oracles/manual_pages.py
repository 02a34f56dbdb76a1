"""Commands and code blocks of the manual's pages."""

import re
from dataclasses import dataclass

from operator_app.manual.pages import FOLDER

BLOCK = re.compile(r"((?:<!--[^\n]*-->\n)*)```(\w+)\n(.*?)```", re.DOTALL)
MARK = re.compile(r"<!-- (run|file): (.*?) -->")
OTHER_PROGRAMS = (
    "python3 -m venv ", ".venv/bin/pip ", "source ", "sudo ip link ", "pip install ", "eval ",
    "python ", "CAN_INTERFACE=",
)  # fmt: skip
"""Prefixes of the pages' commands of other programs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """A block of code: its language, and the page's comment on how to run it."""

    language: str
    text: str
    run: str
    file: str

    @property
    def commands(self) -> list[str]:
        return self.text.replace("\\\n", " ").splitlines() if self.language == "sh" else []


def page_topics() -> list[str]:
    return sorted(f.name[:-3] for f in FOLDER.iterdir() if f.name.endswith(".md"))


def blocks(topic: str) -> list[Block]:
    page_blocks = []
    for comments, language, text in BLOCK.findall((FOLDER / f"{topic}.md").read_text()):
        marks = {"run": "", "file": "", **dict(MARK.findall(comments))}
        page_blocks.append(Block(language=language, text=text, **marks))
    return page_blocks
