"""Generated pages are complete, compared with --help, packaged files and the EDS files as text."""

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
    if isinstance(node, dict):
        return {str(k) for k in node} | {key for value in node.values() for key in keys(value)}
    return {key for item in node for key in keys(item)} if isinstance(node, list) else set()


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_every_option_is_in_the_manual(command, capsys):
    with pytest.raises(SystemExit):
        cli.main([*command.split(), "--help"])
    help_text = capsys.readouterr().out
    options = set(re.findall(r"(?<=[ \[])--[a-z][a-z-]+", help_text)) - {"--help", "--version"}
    page = manual().page("commands").markdown
    missing = {option for option in options if f"`{option}" not in page}
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
    page = manual().page(topic).markdown
    parameters = {"theta_off_1", "theta_off_4", "theta_off_7"}  # keys of `held`
    for file in (ROOT / folder).glob("*.yaml"):
        in_file = keys(yaml.safe_load(file.read_text()))
        assert not {k for k in in_file - parameters if f"| `{k}` |" not in page}, file.name


@pytest.mark.parametrize("kind", get_args(FileKind))
def test_every_key_has_a_meaning(kind):
    page = manual().page(f"{kind}-file").markdown
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


def test_every_exit_code_has_a_meaning():
    assert set(MEANING) == set(ExitCode)
    for code in ExitCode:
        assert f"| `{int(code)}` |" in manual().page("exit-codes").markdown
        assert re.search(rf"\b{int(code)} \w", cli.EPILOG)


def test_every_app_key_and_fault_is_in_the_manual():
    from hardware.virtual.faults import FAULT_KINDS
    from operator_app.session.ui.action_table import ACTIONS

    page = manual().page("keys").markdown
    assert not [a.name for a in ACTIONS if f"| {a.label} |" not in page]
    page = manual().page("faults").markdown
    assert not [kind for kind in FAULT_KINDS if f"| `{kind}` |" not in page]
