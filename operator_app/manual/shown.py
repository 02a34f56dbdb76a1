"""Renders pages of the manual as text for a terminal of any width, with rich.

A link to a page is followed by the command that shows this page. A picture becomes its description. Comments are for
tests and are not shown.
"""

import io
import re
from typing import Any, ClassVar

from rich.console import Console, ConsoleOptions, RenderResult
from rich.markdown import CodeBlock, Heading, Markdown, TableElement
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

LINK = re.compile(r"(?<!!)\[([^\]]+)\]\(([^)\s]+)\)")
PICTURE = re.compile(r"!\[([^\]]*)\]\([^)]*\)")
HTML_COMMENT = re.compile(r"<!--.*?-->\n?", re.DOTALL)
CODE, FENCE = re.compile(r"(`[^`\n]+`)"), re.compile(r"(^```.*?^```$)", re.DOTALL | re.MULTILINE)
PLAIN_GLYPHS = str.maketrans("─•", "--")
"""Replacements for characters that some terminals cannot show."""
MANY_COLUMNS, TALLEST = 4, 8
"""A table with at least `MANY_COLUMNS` columns and, on average, over `TALLEST` lines per row is shown as blocks."""


def as_text(markdown: str, width: int) -> str:
    """Return a page as text, at most `width` characters wide except for longer lines of code."""
    text = "".join(
        part if part.startswith("```") else _inline(part)
        for part in FENCE.split(HTML_COMMENT.sub("", markdown))
    )
    file = io.StringIO()
    console = Console(file=file, width=width, color_system=None, force_terminal=False, emoji=False)
    console.print(_Page(text, hyperlinks=False), crop=False)
    shown = file.getvalue().translate(PLAIN_GLYPHS)
    return "\n".join(line.rstrip() for line in shown.splitlines()).strip("\n") + "\n"


def _inline(text: str) -> str:
    """Replace links by text that names their target; keep the backticks around code, as no colour marks it."""
    text = PICTURE.sub(r"\\[Picture: \1]", text)
    text = LINK.sub(lambda m: m[1] + _target(m[2]), text)
    return CODE.sub(r"`` \1 ``", text)


def _target(link: str) -> str:
    """Return the target of a link as text: the command that shows a page, or an address; "" within the same page."""
    if page := re.fullmatch(r"([a-z0-9-]+)\.md(#.*)?", link):
        return f" (sarcal help {page[1]})"
    return "" if link.startswith("#") else f" ({link})"


class _Underlined(Heading):
    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        yield self.text
        if self.tag in ("h1", "h2"):
            yield Text(("=" if self.tag == "h1" else "-") * min(len(self.text), options.max_width))


class _Verbatim(CodeBlock):
    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        code = str(self.text).rstrip("\n").splitlines()
        yield Text("\n".join(f"    {row}" for row in code), no_wrap=True, overflow="ignore")


class _Rows(TableElement):
    """A table with wrapped cells. A table with many columns and tall rows becomes one block of lines per row."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for table in super().__rich_console__(console, options):
            if not isinstance(table, Table):
                yield table
                continue
            for column in table.columns:
                column.overflow = "fold"
            # Names that are to be typed are not wrapped.
            names = [len(str(cell)) for cell in table.columns[0].cells]
            table.columns[0].no_wrap = max(names, default=0) <= options.max_width // 3
            table.pad_edge = False
            lines = len(console.render_lines(table, options, pad=False))
            if len(table.columns) < MANY_COLUMNS or lines <= TALLEST * (table.row_count + 1):
                yield table
                continue
            head, *rest = table.columns
            for name, *cells in zip(head.cells, *(c.cells for c in rest), strict=True):
                yield Text(f"\n{name}")
                for column, cell in zip(rest, cells, strict=True):
                    yield Padding(Text(f"{column.header}: {cell}"), (0, 0, 0, 4))


class _Page(Markdown):
    elements: ClassVar[Any] = {
        **Markdown.elements,
        "heading_open": _Underlined,
        "fence": _Verbatim,
        "code_block": _Verbatim,
        "table_open": _Rows,
    }
