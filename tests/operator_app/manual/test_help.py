"""`sarcal help`: topics, pages of any width, suggestions; links and anchors of every page exist."""

import re
from functools import cache

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


def test_unknown_topic_gets_a_suggestion_and_the_list(run_command):
    for misspelt, meant in (("comands", "commands"), ("arm", "arm-file"), ("exprot", "export")):
        message = run_command(2, "help", misspelt).err
        assert f"the manual has no topic {misspelt!r}; did you mean {meant}?" in message
        assert all(topic in message for topic in TOPICS)


def test_command_is_a_topic_and_page_is_available_as_markdown(run_command):
    assert "`--remounted`" in run_command(0, "help", "compare").out
    assert run_command(0, "help", TOPICS[0], "--markdown").out == manual().page(TOPICS[0]).markdown


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
