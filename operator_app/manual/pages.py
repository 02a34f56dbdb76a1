"""The pages of the manual, in their order, and the source of each.

The text is Markdown in `pages`. Options, keys of files, faults, objects and exit codes are generated from the code when
a page is read, so that no second copy can become outdated.
"""

import difflib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.resources import files

MANUAL = files("operator_app") / "manual"
CONTENTS = (MANUAL / "contents.md").read_text(encoding="utf-8")
"""The table of contents as Markdown: a heading for each section, below it a table of topics."""
SECTIONS: Mapping[str, Mapping[str, str]] = {
    section.partition("\n")[0]: dict(
        re.findall(r"^\| `([\w-]+)` \| (.+) \|$", section, re.MULTILINE)
    )
    for section in CONTENTS.split("\n## ")[1:]
}
"""Topics by section, in the order of reading, with a summary in one line."""

FILE = re.compile(r"<!-- file: ([\w.-]+) -->\n```\w+\n(.*?)```", re.DOTALL)
"""Pattern of the mark and the content of a code block that is a complete file."""

FILES_OF = re.compile(r"<!-- files of: ([\w-]+) -->")
"""Pattern of the mark by which a page includes the files of another page."""

NOTEBOOK = re.compile(r"<!-- notebook: ([\w.-]+) -->")
NOTEBOOKS = MANUAL / "notebooks"
FOLDER = MANUAL / "pages"


class NoSuchTopicError(Exception):
    """There is no page with this name; the error's text gives the most similar name and lists all pages."""

    def __init__(self, topic: str, topics: tuple[str, ...]) -> None:
        near = [name for name in topics if topic and name.startswith(topic)]
        near = near[:1] or difflib.get_close_matches(topic, topics, n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        super().__init__(f"the manual has no topic {topic!r}; {hint}all: {', '.join(topics)}")


def files_on(page: str) -> Mapping[str, str]:
    """Return file contents by name: complete files on `page` (Markdown), those of included pages, and notebooks."""
    shown: dict[str, str] = dict(FILE.findall(page))
    for topic in FILES_OF.findall(page):
        shown |= FILE.findall(_written(topic))
    for name in NOTEBOOK.findall(page):
        shown[name] = (NOTEBOOKS / name).read_text(encoding="utf-8")
    return shown


def made_by_code(topic: str) -> bool:
    """Whether a page is generated; all other pages are files."""
    return not (FOLDER / f"{topic}.md").is_file()


class Manual:
    """All pages of the manual. `commands` returns the page about the commands; if it is None, that page is missing."""

    def __init__(self, commands: Callable[[], str] | None = None) -> None:
        self._commands = commands

    @property
    def topics(self) -> Mapping[str, str]:
        """One-line summary of each page, keyed by topic, in reading order."""
        every = {topic: text for topics in SECTIONS.values() for topic, text in topics.items()}
        return {t: text for t, text in every.items() if self._commands or t != "commands"}

    def page(self, topic: str) -> str:
        """Return a page as Markdown; raises NoSuchTopicError if there is none with this name."""
        name = topic.strip().lower().removesuffix(".md")
        if name not in self.topics:
            raise NoSuchTopicError(topic, tuple(self.topics))
        if name == "commands" and self._commands is not None:
            return self._commands()
        if made_by_code(name):
            from operator_app.manual.code_pages import PAGES

            return PAGES[name]()
        return _written(name)


def _written(topic: str) -> str:
    return (FOLDER / f"{topic}.md").read_text(encoding="utf-8")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table; line breaks in a cell become spaces."""
    lines = (
        [" ".join(cell.split()).replace("|", "\\|") for cell in line]
        for line in (head, ["---"] * len(head), *rows)
    )
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
