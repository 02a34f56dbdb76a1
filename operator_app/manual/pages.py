"""The pages of the manual, in their order, and the source of each.

The text is Markdown in `pages`. Options, keys of files, faults, objects and exit codes are generated from the code when
a page is read, so that no second copy can become outdated.
"""

import difflib
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.resources import files
from types import MappingProxyType

SECTIONS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "Tutorial": {"tutorial": "your first calibration, on the simulated arm"},
        "How to": {
            "terminal-app": "work in the terminal app",
            "own-arm": "describe your own arm, plan, rehearse",
            "packaged-arms": "the built-in arms, and what was tried on real ones",
            "outside-arm": "connect an arm that is not on CAN, by a package",
            "own-hinge": "build and describe your own hinge",
            "own-poses": "calibrate from readings that you have",
            "recordings": "calibrate from a ROS 2 bag or a log over time",
            "real-can": "go on a real CAN bus, in a safe order",
            "stopped": "what to do when the arm has stopped",
            "still-valid": "see whether a calibration still holds",
            "planned-poses": "have the poses chosen",
            "wrist-repair": "see which offsets moved in a repair",
            "over-the-years": "follow an arm over the years: shifts, and when to calibrate next",
            "exporting": "put a calibration into your own URDF, xacro or UR file",
            "corrections": "apply the corrections of readings in your own controller",
            "notebooks": "two notebooks, for readings of your own",
            "scripting": "use it from a shell script or from Python",
            "recording": "keep the frames of a bus",
        },
        "Reference": {
            "commands": "every command and option",
            "exit-codes": "exit codes of all commands",
            "poses-file": "columns of a poses file",
            "outside-arm-files": "files of an example package for an arm that is not on CAN",
            "instrument-port": "how an instrument sends where the tool is",
            "user-settings": "set your usual bus, theme and name",
            "session-folder": "what is in a session folder",
            "arm-file": "keys of an arm file",
            "fixture-file": "keys of a fixture file",
            "procedure-file": "keys of a procedure file",
            "profile-file": "keys of a bus profile",
            "parameters-file": "keys of a parameters file",
            "keys": "keys of the terminal app",
            "panels": "what each panel of the terminal app shows",
            "faults": "what can go wrong, what you see, what to do",
            "objects": "object dictionary of drive and supervisor",
        },
        "Explanation": {
            "accepted": "what ACCEPTED means, and what it does not",
            "limits": "what a closed loop cannot tell",
            "accuracy": "how good the results are: measured figures, with date and command",
            "simulated": "what is simulated, and what was tried on real arms",
            "safety": "what is checked before and while the arm moves",
            "sign": "the sign of offsets, and the D-H convention",
            "mounting": "which offsets survive a remounting",
            "error-model": "what the calibration does, and which errors it models",
            "paper": "which command does which part of the paper",
        },
    }
)
"""Topics by section, in the order of reading, with a summary in one line."""

FILE = re.compile(r"<!-- file: ([\w.-]+) -->\n```\w+\n(.*?)```", re.DOTALL)
"""Pattern of the mark and the content of a code block that is a complete file."""

FILES_OF = re.compile(r"<!-- files of: ([\w-]+) -->")
"""Pattern of the mark by which a page includes the files of another page."""

NOTEBOOK = re.compile(r"<!-- notebook: ([\w.-]+) -->")
NOTEBOOKS = files("operator_app") / "manual" / "notebooks"
FOLDER = files("operator_app") / "manual" / "pages"


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
