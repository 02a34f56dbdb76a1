"""The user's settings: shown, changed, weaker than everything else, and one clear error where they are wrong."""

import io
from dataclasses import replace
from pathlib import Path

import pytest

from hardware.buses.python_can import BusSettings, bus_settings
from operator_app.cli import main
from operator_app.commands.choices import choices_from, opening_from
from operator_app.commands.table import parser_of
from operator_app.composition import unattended
from operator_app.config.user_settings import load_settings, usual_bus
from operator_app.effective_procedure import effective_procedure, session_bus
from operator_app.session.store.journal import read_journal
from operator_app.session.workflow.opening import begin


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.chdir(tmp_path)
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_BITRATE"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path / "config" / "sarcal" / "settings.yaml"


def test_they_are_set_shown_and_taken_away(file, ends_with):
    assert "there is none" in ends_with(0, "settings").out
    words = ["interface=socketcan", "channel=can3", "bitrate=500000", "operator=R. Hand"]
    ends_with(0, "settings", *words)
    shown = ends_with(0, "settings", "bitrate=", "theme=light", "--json").json
    assert shown["file"] == str(file)
    assert shown["settings"]["operator"] == "R. Hand"
    assert load_settings().stated == {
        "interface": "socketcan",
        "channel": "can3",
        "theme": "light",
        "operator": "R. Hand",
    }
    assert file.read_text().startswith("schema: sarcal/settings/1\n")


def test_everything_else_is_stronger(file, monkeypatch):
    main(["settings", "interface=socketcan", "channel=can3", "bitrate=500000"])
    usual = usual_bus()
    assert bus_settings(otherwise=usual) == BusSettings(
        interface="socketcan", channel="can3", bitrate=500000
    )
    assert bus_settings("virtual", otherwise=usual).interface == "virtual"
    assert bus_settings("loopback", otherwise=usual).channel == "sarcal"
    assert bus_settings(channel="can1", otherwise=usual).channel == "can1"
    monkeypatch.setenv("CAN_CHANNEL", "can2")
    assert bus_settings(otherwise=usual).channel == "can2"
    monkeypatch.setenv("CAN_INTERFACE", "loopback")
    assert bus_settings(otherwise=usual).interface == "loopback"


@pytest.mark.parametrize(
    ("options", "virtual"), [([], False), (["--seed", "0"], True), (["-i", "virtual"], True)]
)
def test_who_names_a_virtual_arm_means_one(file, tmp_path, options, virtual):
    main(["settings", "interface=socketcan", "channel=can3", "operator=R. Hand"])
    choices = choices_from(parser_of("run").parse_args(["hinge", *options]))
    assert choices.operator == "R. Hand"
    opening = begin("hinge", choices, root=tmp_path)
    assert (session_bus(choices, opening.procedure).interface == "virtual") is virtual
    assert effective_procedure(opening).arm.joint_count == 7


def test_a_procedures_virtual_names_no_bus_and_that_is_said(file, tmp_path, ends_with):
    line = ["new", "procedure", "--arm", "franka_panda", "--fixture", "hinge", "-o", "go.yaml"]
    ends_with(0, *line)
    said = ends_with(0, "settings", "interface=socketcan", "channel=can3").out
    assert "`virtual` in a procedure names no bus" in said
    choices = choices_from(parser_of("run").parse_args(["go.yaml"]))
    opening = begin("go.yaml", choices, root=tmp_path)
    assert opening.procedure.bus.interface == "virtual"
    assert session_bus(choices, opening.procedure).interface == "socketcan"


def test_the_operator_is_in_the_journal(file, tmp_path):
    main(["settings", "operator=R. Hand"])
    choices = choices_from(parser_of("run").parse_args(["hinge", "--scenario", "exact"]))
    opening = begin("hinge", choices, root=tmp_path)
    with unattended(opening) as session:
        session.connect()
        settings = read_journal(opening.folder).events[0].data["settings"]
    assert settings["operator"] == "R. Hand"


@pytest.mark.parametrize(
    "text",
    [
        "schema: sarcal/settings/1\nintreface: socketcan\n",
        "schema: sarcal/settings/1\ntheme: pink\n",
        "schema: sarcal/settings/1\nbitrate: fast\n",
        "schema: sarcal/arm/1\n",
        "- socketcan\n",
        "",
    ],
)
def test_a_file_that_is_wrong_is_one_clear_error(file, ends_with, text, approve):
    file.parent.mkdir(parents=True)
    file.write_text(text)
    for command in (["settings"], ["run", "hinge"], ["probe"]):
        told = ends_with(2, *command).err
        assert str(file) in told
        approve(told)
        assert "Traceback" not in told
    assert not Path("sessions").exists()


@pytest.mark.parametrize("word", ["interface", "colour=red", "=x"])
def test_a_word_that_is_no_setting_says_which_there_are(file, ends_with, word):
    assert "interface, channel, bitrate, theme, operator" in ends_with(2, "settings", word).err
    ends_with(2, "settings", "theme=pink")
    ends_with(2, "settings", "bitrate=" + 5000 * "9")
    assert not file.exists()


WRONG = "schema: sarcal/settings/1\ninterface: socketcan\ntheme: pink\nintreface: x\n"


@pytest.fixture
def wrong(file):
    file.parent.mkdir(parents=True)
    file.write_text(WRONG)
    return file


def test_a_wrong_file_is_mended_key_by_key(wrong, ends_with):
    assert f"{wrong}:4: intreface" in ends_with(2, "settings", "theme=dark").err
    assert wrong.read_text() == WRONG
    ends_with(0, "settings", "theme=dark", "intreface=")
    assert load_settings().stated == {"interface": "socketcan", "theme": "dark"}
    wrong.write_text("theme: dark\n")
    ends_with(0, "settings", "operator=R. Hand")
    assert load_settings().stated == {"theme": "dark", "operator": "R. Hand"}
    other = "schema: sarcal/arm/1\nname: mine\n"
    wrong.write_text(other)
    ends_with(2, "settings", "theme=dark", "name=")
    assert wrong.read_text() == other


def test_reset_on_a_bus_that_is_named_needs_no_settings(wrong):
    opening = opening_from(parser_of("reset").parse_args(["-i", "loopback"]))
    assert session_bus(opening.choices, opening.procedure).interface == "loopback"
    assert main(["reset"]) == 2


def test_who_names_a_bus_does_without_a_wrong_file_and_is_told(
    wrong, tmp_path, monkeypatch, capsys
):
    """It may hold who works here; that is nothing to stop a calibration for."""
    choices = choices_from(parser_of("run").parse_args(["hinge", "-i", "virtual"]))
    said = " ".join(capsys.readouterr().err.split())
    assert f"{wrong} is invalid, and its theme and operator are not used" in said
    assert "`sarcal settings` shows what is wrong" in said
    assert choices.operator is None
    opening = begin("hinge", choices, root=tmp_path)
    assert session_bus(choices, opening.procedure).interface == "virtual"
    monkeypatch.setenv("CAN_INTERFACE", "loopback")
    assert session_bus(replace(choices, interface=None), opening.procedure).interface == "loopback"
    # The simulated arm of another program has no operator.
    choices_from(parser_of("controller").parse_args([]), journal=False)
    assert capsys.readouterr().err == ""


def test_the_app_begins_with_a_wrong_file_and_says_so_on_its_screen(
    wrong, tmp_path, monkeypatch, ends_with
):
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    said = ends_with(0, "--plain", "-i", "virtual", "--sessions", tmp_path / "sessions").words
    assert f"warning] {wrong} is invalid" in said
    assert said.count(str(wrong)) == 1


def test_an_interface_is_looked_at_when_it_is_set(file, ends_with):
    said = ends_with(2, "settings", "interface=bogus").err
    assert "'bogus'" in said
    assert "loopback" in said
    assert "socketcan" in said
    assert not file.exists()
    for known in ("loopback", "virtual", "slcan"):
        ends_with(0, "settings", f"interface={known}")


@pytest.mark.parametrize(
    ("stated", "code", "words"),
    [
        ("interface: bogus", 2, "Use one of"),
        ("interface: socketcan", 2, "No channel is given"),
        ("interface: socketcan\nchannel: nosuchcan9", 3, "nosuchcan9|no CAN sockets"),
    ],
)
def test_a_bus_of_the_settings_that_does_not_work_names_their_file(
    file, ends_with, stated, code, words
):
    file.parent.mkdir(parents=True)
    file.write_text(f"schema: sarcal/settings/1\n{stated}\n")
    said = ends_with(code, "probe").err
    assert str(file) in said
    assert any(word in said for word in words.split("|")), said
