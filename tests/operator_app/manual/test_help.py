"""`sarcal help`: topics, pages of any width, the nearest of a misspelt one; every link leads somewhere."""

import re
from functools import cache

import pytest

from operator_app.commands.help_topic import manual
from operator_app.manual.pages import FOLDER, SECTIONS
from operator_app.manual.shown import as_text

TOPICS = manual().topics


@cache
def markdown(topic: str) -> str:
    return manual().page(topic).markdown


def test_help_lists_every_topic_with_what_it_is(ends_with):
    said = ends_with(0, "help").out
    for section, topics in SECTIONS.items():
        assert section in said
        for topic, summary in topics.items():
            assert re.search(rf"^ `{topic}` +{re.escape(summary)}$", said, re.MULTILINE), topic


def test_every_page_has_a_topic_and_every_topic_a_page():
    written = {file.name[:-3] for file in FOLDER.iterdir() if file.name.endswith(".md")}
    made = {topic for topic in TOPICS if manual().made_by_code(topic)}
    assert written - {"index"} == set(TOPICS) - made
    assert not written & made


@pytest.mark.sample(12)
@pytest.mark.parametrize("topic", TOPICS)
def test_a_page_is_shown_in_80_columns(topic, ends_with):
    said = ends_with(0, "help", topic).out
    page = manual().page(topic)
    assert said.splitlines()[:2] == [page.title, "=" * len(page.title)]
    # Code keeps its lines; a table whose longest words fill it may not become narrower.
    for line in as_text(page.markdown, 80).splitlines():
        assert len(line) <= 80 or line.startswith("    ") or "  " in line, line


@pytest.mark.parametrize(
    ("typed", "meant"), [("comands", "commands"), ("arm", "arm-file"), ("exprot", "export")]
)
def test_an_unknown_topic_gets_the_nearest(typed, meant, ends_with):
    said = ends_with(2, "help", typed).err
    assert f"the manual has no topic {typed!r}; did you mean {meant}?" in said
    assert all(topic in said for topic in TOPICS)


def test_a_command_is_a_topic_too(ends_with):
    assert "`--remounted`" in ends_with(0, "help", "compare").out


def test_a_page_can_be_had_as_it_is_written(ends_with):
    assert ends_with(0, "help", TOPICS[0], "--markdown").out == manual().page(TOPICS[0]).markdown


def anchors(page: str) -> set[str]:
    """Anchors of the headings, by the rule of Markdown's table of contents, written down once more."""
    found = re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", page, flags=re.DOTALL), re.MULTILINE)
    slugs = (re.sub(r"[^\w\s-]", "", text.replace("`", "")).strip().lower() for text in found)
    return {re.sub(r"[-\s]+", "-", slug) for slug in slugs}


@pytest.mark.parametrize("topic", TOPICS)
def test_no_link_is_dead(topic):
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


def test_markdown_becomes_text():
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
