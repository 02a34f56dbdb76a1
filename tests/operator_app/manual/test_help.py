"""`sarcal help` and the site: topics, pages of any width, suggestions; links and anchors of every page exist."""

import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from operator_app.commands.help_topic import manual
from operator_app.manual.code_pages import PAGES
from operator_app.manual.pages import FOLDER, SECTIONS, made_by_code
from operator_app.manual.shown import as_text

TOPICS = manual().topics


@cache
def markdown(topic: str) -> str:
    return manual().page(topic).markdown


def test_help_lists_every_topic_with_its_summary(run_command):
    output = run_command(0, "help").out
    for section, topics in SECTIONS.items():
        assert section in output
        for topic, summary in topics.items():
            assert re.search(rf"^ `{topic}` +{re.escape(summary)}$", output, re.MULTILINE), topic


def test_every_page_is_a_topic():
    written = {file.name[:-3] for file in FOLDER.iterdir() if file.name.endswith(".md")}
    generated = {topic for topic in TOPICS if made_by_code(topic)}
    assert written - {"index"} == set(TOPICS) - generated
    assert generated == {*PAGES, "commands"}


@pytest.mark.sample(12)
@pytest.mark.parametrize("topic", TOPICS)
def test_page_fits_into_80_columns(topic, run_command):
    output = run_command(0, "help", topic).out
    page = manual().page(topic)
    assert output.splitlines()[:2] == [page.title, "=" * len(page.title)]
    # Code and tables with long words may be wider.
    for line in as_text(page.markdown, 80).splitlines():
        assert len(line) <= 80 or line.startswith("    ") or "  " in line, line


def test_topics_are_pages_or_commands_and_unknown_ones_get_a_suggestion(run_command):
    assert "`--remounted`" in run_command(0, "help", "compare").out
    assert run_command(0, "help", TOPICS[0], "--markdown").out == markdown(TOPICS[0])
    for misspelt, meant in (("comands", "commands"), ("arm", "arm-file"), ("exprot", "export")):
        message = run_command(2, "help", misspelt).err
        assert f"the manual has no topic {misspelt!r}; did you mean {meant}?" in message
        assert all(topic in message for topic in TOPICS)


def anchors(page: str) -> set[str]:
    """Anchors of the headings by the rule of Markdown's table of contents, implemented independently."""
    headings = re.findall(
        r"^#+ (.+)$", re.sub(r"```.*?```", "", page, flags=re.DOTALL), re.MULTILINE
    )
    slugs = (re.sub(r"[^\w\s-]", "", text.replace("`", "")).strip().lower() for text in headings)
    return {re.sub(r"[-\s]+", "-", slug) for slug in slugs}


@pytest.mark.parametrize("topic", TOPICS)
def test_links_and_anchors_exist(topic):
    text = re.sub(r"```.*?```", "", markdown(topic), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)]+)\)", text):
        if target.startswith("https://"):
            continue
        name, _, anchor = target.partition("#")
        if name.endswith((".svg", ".png")):
            assert (FOLDER / name).is_file(), target
            continue
        assert not name or name.removesuffix(".md") in TOPICS, target
        other = markdown(name.removesuffix(".md") or topic)
        assert not anchor or anchor in anchors(other), target


def test_markdown_is_rendered_as_text():
    page = (
        "# Title\n\n<!-- run: nothing -->\nSome **bold** text and [a page](own-arm.md#x),\n"
        "![a screen](pictures/a.svg)\n\n- one\n  two\n1. three\n\n```sh\nsarcal  run\n```\n"
        "\n| a | b |\n|---|---|\n| one | two words \\| more |\n"
    )
    assert as_text(page, 40) == (
        "Title\n=====\n\nSome bold text and a page (sarcal help\nown-arm), [Picture: a screen]\n\n"
        " - one two\n\n 1 three\n\n    sarcal  run\n\n\n"
        " a    b\n ---------------------\n one  two words | more\n"
    )


ROOT = Path(__file__).resolve().parents[3]


FETCHED = re.compile(
    r"""<(?:script|img|iframe|source)\b[^>]*\bsrc=["']?(?:https?:)?//"""
    r"""|<link\b(?![^>]*\brel=["']?(?:prev|next|canonical)\b)[^>]*\bhref=["']?(?:https?:)?//"""
)
"""An address outside the site that a browser fetches to show a page."""


def test_site_has_every_page_and_needs_no_network(tmp_path):
    pytest.importorskip("material", reason="needs the extra [docs]")
    config = ROOT / "operator_app/manual/mkdocs.yml"
    # mkdocs.yml is strict: an invalid link or anchor fails the build.
    options = ["build", "-q", "-f", str(config), "-d", str(tmp_path)]
    build = subprocess.run(
        [sys.executable, "-m", "mkdocs", *options],
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert build.returncode == 0, build.stderr
    topics = [topic for section in SECTIONS.values() for topic in section]
    for topic in ("index", *topics):
        page = (tmp_path / f"{topic}.html").read_text()
        assert not FETCHED.search(page), topic
    assert "--remounted" in (tmp_path / "commands.html").read_text()
