"""What the manual's pages tell people to type, and a folder in which it can be typed. Runs nothing."""

import re
from dataclasses import dataclass

from operator_app.manual.pages import FOLDER

BLOCK = re.compile(r"((?:<!--[^\n]*-->\n)*)```(\w+)\n(.*?)```", re.DOTALL)
MARK = re.compile(r"<!-- (run|file): (.*?) -->")
NOT_OURS = (
    "python3 -m venv ",
    ".venv/bin/pip ",
    "source ",
    "sudo ip link ",
    "pip install ",
    "eval ",
    "python ",
    "CAN_INTERFACE=",
)
"""What the pages type beside `sarcal`: the system's own commands."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """A block of code: its language, and how its page says that it is run."""

    language: str
    text: str
    run: str
    file: str

    @property
    def commands(self) -> list[str]:
        """What a person types after a prompt, line by line."""
        return self.text.replace("\\\n", " ").splitlines() if self.language == "sh" else []


def written_topics() -> list[str]:
    """Topics whose pages are files."""
    return sorted(f.name[:-3] for f in FOLDER.iterdir() if f.name.endswith(".md"))


def blocks(topic: str) -> list[Block]:
    """The blocks of a page, from top to bottom."""
    found = []
    for marks, language, text in BLOCK.findall((FOLDER / f"{topic}.md").read_text()):
        said = dict(MARK.findall(marks))
        found.append(
            Block(language=language, text=text, run=said.get("run", ""), file=said.get("file", ""))
        )
    return found
