"""`sarcal help` and the site: topics, links and anchors; generated pages are complete, compared with their sources."""

import configparser
import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import get_args

import pytest
import yaml

from operator_app import cli
from operator_app.commands.help_topic import manual
from operator_app.commands.table import COMMANDS
from operator_app.config.any_file import FileKind, json_schema
from operator_app.exit_codes import MEANING, ExitCode
from operator_app.manual.code_pages import PAGES
from operator_app.manual.pages import FOLDER, SECTIONS, made_by_code
from operator_app.manual.shown import as_text

ROOT = Path(__file__).resolve().parents[3]


def keys(node: object) -> set[str]:
    if isinstance(node, dict):
        return {str(k) for k in node} | {key for value in node.values() for key in keys(value)}
    return {key for item in node for key in keys(item)} if isinstance(node, list) else set()


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_every_option_is_in_the_manual(command, capsys):
    with pytest.raises(SystemExit):
        cli.main([*command.split(), "--help"])
    help_text = capsys.readouterr().out
    options = set(re.findall(r"(?<=[ \[])--[a-z][a-z-]+", help_text)) - {"--help", "--version"}
    page = manual().page("commands")
    missing = {option for option in options if f" {option}" not in page}
    assert not missing
    assert f"## sarcal {command}".strip() in page


@pytest.mark.parametrize(
    ("topic", "folder"),
    [
        ("arm-file", "operator_app/data/arms"),
        ("fixture-file", "fixtures/data"),
        ("procedure-file", "operator_app/data/procedures"),
        ("profile-file", "operator_app/data/profiles"),
    ],
)
def test_every_key_of_packaged_files_is_in_the_manual(topic, folder):
    page = manual().page(topic)
    parameters = {"theta_off_1", "theta_off_4", "theta_off_7"}  # keys of `held`
    for file in (ROOT / folder).glob("*.yaml"):
        in_file = keys(yaml.safe_load(file.read_text()))
        assert not {k for k in in_file - parameters if f"| `{k}` |" not in page}, file.name


@pytest.mark.parametrize("kind", get_args(FileKind))
def test_every_key_has_a_meaning(kind):
    page = manual().page(f"{kind}-file")
    assert not re.findall(r"^\| `\w+` .*\|\s*\|$", page, re.MULTILINE)
    # No meaning is stated for unknown keys, or for keys that their model describes.
    meanings = yaml.safe_load((ROOT / "operator_app/data/key_meanings.yaml").read_text())[kind]
    models = json_schema(kind)["$defs"]
    used = {
        name
        for model, spec in models.items()
        for key, value in spec["properties"].items()
        for name in (key, f"{model}.{key}")
        if value.get("description") == meanings.get(name)
    }
    assert set(meanings) <= used


def test_every_eds_object_is_in_the_manual():
    joint, supervisor = manual().page("objects").split("## Supervisor")
    for name, text in (("joint", joint), ("supervisor", supervisor)):
        eds = configparser.ConfigParser(strict=False, interpolation=None)
        eds.read(ROOT / f"hardware/eds/{name}.eds")
        objects = [s for s in eds.sections() if re.fullmatch(r"[0-9A-F]{4}(sub[0-9A-F]+)?", s)]
        assert len(objects) > 30
        for section in objects:
            index, _, sub = section.partition("sub")
            place = f"`{index}h sub {int(sub, 16)}`" if sub and int(sub, 16) else f"`{index}h`"
            assert place in text, section


def test_every_exit_code_has_a_meaning():
    assert set(MEANING) == set(ExitCode)
    for code in ExitCode:
        assert f"| `{int(code)}` |" in manual().page("exit-codes")
        assert re.search(rf"\b{int(code)} \w", cli.EPILOG)


def test_every_app_key_and_fault_is_in_the_manual():
    from hardware.virtual.fault_messages import FAULTS
    from operator_app.session.ui.action_table import ACTIONS

    page = manual().page("keys")
    assert not [a.name for a in ACTIONS if f"| {a.label} |" not in page]
    assert not [kind for kind in FAULTS if f"| `{kind}` |" not in manual().page("faults")]


TOPICS = tuple(manual().topics)


@cache
def markdown(topic: str) -> str:
    return manual().page(topic)


def test_help_lists_every_topic(run_command):
    output = run_command(0, "help").out
    assert all(f"\n `{topic}` " in output for topic in TOPICS)


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
    title = page.partition("\n")[0].removeprefix("# ")
    assert output.splitlines()[:2] == [title, "=" * len(title)]
    # Code and tables with long words may be wider.
    for line in as_text(page, 80).splitlines():
        assert len(line) <= 80 or line.startswith("    ") or "  " in line, line


def test_topics_are_pages_or_commands_and_unknown_ones_get_a_suggestion(run_command):
    assert " --remounted " in run_command(0, "help", "compare").out
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
