"""Pages that code makes hold what the code has: against --help, the packaged files, the EDS as plain text."""

import configparser
import re
from pathlib import Path
from typing import get_args

import pytest
import yaml

from operator_app import cli
from operator_app.commands.help_topic import manual
from operator_app.commands.table import COMMANDS
from operator_app.config.any_file import FileKind, json_schema
from operator_app.exit_codes import MEANING, ExitCode

ROOT = Path(__file__).resolve().parents[3]


def keys(node: object) -> set[str]:
    """Every key of a YAML document."""
    if isinstance(node, dict):
        return {str(k) for k in node} | {key for value in node.values() for key in keys(value)}
    return {key for item in node for key in keys(item)} if isinstance(node, list) else set()


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_every_option_that_a_command_prints_is_on_its_page(command, capsys):
    with pytest.raises(SystemExit):
        cli.main([*command.split(), "--help"])
    said = capsys.readouterr().out
    wanted = set(re.findall(r"(?<=[ \[])--[a-z][a-z-]+", said)) - {"--help", "--version"}
    page = manual().page("commands").markdown
    missing = {option for option in wanted if f"`{option}" not in page}
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
def test_every_key_of_a_packaged_file_is_explained(topic, folder):
    page = manual().page(topic).markdown
    free = {"theta_off_1", "theta_off_4", "theta_off_7"}  # parameters, which `held` has for keys
    for file in (ROOT / folder).glob("*.yaml"):
        missing = {
            k for k in keys(yaml.safe_load(file.read_text())) - free if f"| `{k}` |" not in page
        }
        assert not missing, file.name


@pytest.mark.parametrize("kind", get_args(FileKind))
def test_every_key_of_a_file_has_a_meaning(kind):
    page = manual().page(f"{kind}-file").markdown
    assert not re.findall(r"^\| `\w+` .*\|\s*\|$", page, re.MULTILINE)
    # And nothing is explained that there is not, or that its model explains.
    given = yaml.safe_load((ROOT / "operator_app/data/key_meanings.yaml").read_text())[kind]
    models = json_schema(kind)["$defs"]
    shown = {
        name
        for model, spec in models.items()
        for key, value in spec["properties"].items()
        for name in (key, f"{model}.{key}")
        if value.get("description") == given.get(name)
    }
    assert set(given) <= shown


def test_every_object_of_the_eds_files_is_on_the_page():
    joint, supervisor = manual().page("objects").markdown.split("## Supervisor")
    for name, text in (("joint", joint), ("supervisor", supervisor)):
        eds = configparser.ConfigParser(strict=False, interpolation=None)
        eds.read(ROOT / f"hardware/eds/{name}.eds")
        objects = [s for s in eds.sections() if re.fullmatch(r"[0-9A-F]{4}(sub[0-9A-F]+)?", s)]
        assert len(objects) > 30
        for section in objects:
            index, _, sub = section.partition("sub")
            place = f"`{index}h sub {int(sub, 16)}`" if sub and int(sub, 16) else f"`{index}h`"
            assert place in text, section


def test_every_exit_code_has_a_meaning_and_is_in_the_help():
    assert set(MEANING) == set(ExitCode)
    for code in ExitCode:
        assert f"| `{int(code)}` |" in manual().page("exit-codes").markdown
        assert re.search(rf"\b{int(code)} \w", cli.EPILOG)


def test_every_key_of_the_app_and_every_fault_is_listed():
    from hardware.virtual.faults import FAULT_KINDS
    from operator_app.session.ui.action_table import ACTIONS

    page = manual().page("keys").markdown
    assert not [a.name for a in ACTIONS if f"| {a.label} |" not in page]
    page = manual().page("faults").markdown
    assert not [kind for kind in FAULT_KINDS if f"| `{kind}` |" not in page]
