"""User settings: shown, changed, overridden by everything else, one error if invalid."""

import io
from dataclasses import replace
from pathlib import Path

import pytest

from hardware.buses.python_can import BusSettings, bus_settings
from hardware.errors import BusError
from operator_app.cli import main
from operator_app.commands.choices import choices_from, opening_from
from operator_app.commands.table import parser_of
from operator_app.composition import unattended
from operator_app.config.user_settings import load_settings, usual_bus
from operator_app.session.store.journal import read_journal
from operator_app.session.workflow.opening import begin


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.chdir(tmp_path)
    for name in ("CAN_INTERFACE", "CAN_CHANNEL", "CAN_BITRATE"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path / "config" / "sarcal" / "settings.yaml"


def test_settings_are_set_shown_and_removed(file, run_command):
    assert "there is none" in run_command(0, "settings").out
    words = ["interface=socketcan", "channel=can3", "bitrate=500000", "operator=R. Hand"]
    run_command(0, "settings", *words)
    shown = run_command(0, "settings", "bitrate=", "theme=light", "--json").json
    assert shown["file"] == str(file)
    assert shown["settings"]["operator"] == "R. Hand"
    assert load_settings().stated == {
        "interface": "socketcan",
        "channel": "can3",
        "theme": "light",
        "operator": "R. Hand",
    }
    assert file.read_text().startswith("schema: sarcal/settings/1\n")


def test_options_and_environment_take_precedence(file, monkeypatch):
    main(["settings", "interface=socketcan", "channel=can3", "bitrate=500000"])
    bus_setting = usual_bus()
    assert bus_settings(otherwise=bus_setting) == BusSettings(
        interface="socketcan", channel="can3", bitrate=500000
    )
    assert bus_settings("virtual", otherwise=bus_setting).interface == "virtual"
    assert bus_settings("loopback", otherwise=bus_setting).channel == "sarcal"
    assert bus_settings(channel="can1", otherwise=bus_setting).channel == "can1"
    with pytest.raises(BusError, match="The bitrate 0 is not"):
        bus_settings(bitrate=0, otherwise=bus_setting)
    monkeypatch.setenv("CAN_CHANNEL", "can2")
    assert bus_settings(otherwise=bus_setting).channel == "can2"
    monkeypatch.setenv("CAN_INTERFACE", "loopback")
    assert bus_settings(otherwise=bus_setting).interface == "loopback"


@pytest.mark.parametrize(
    ("options", "virtual"), [([], False), (["--seed", "0"], True), (["-i", "virtual"], True)]
)
def test_virtual_options_take_precedence_over_the_bus_setting(file, tmp_path, options, virtual):
    main(["settings", "interface=socketcan", "channel=can3", "operator=R. Hand"])
    choices = choices_from(parser_of("run").parse_args(["hinge", *options]))
    assert choices.operator == "R. Hand"
    opening = begin("hinge", choices, root=tmp_path)
    assert (choices.bus(opening.procedure).interface == "virtual") is virtual
    assert opening.effective_procedure.arm.joint_count == 7


def test_a_bus_without_an_interface_is_not_the_simulated_arm(file, run_command):
    for options in (["-c", "can0"], ["-b", "500000"]):
        message = run_command(2, "run", "hinge", *options).err
        assert f"{' '.join(options)}: no interface is named" in message


def test_virtual_of_a_procedure_uses_the_bus_setting(file, tmp_path, run_command):
    command = ["new", "procedure", "--arm", "franka_panda", "--fixture", "hinge", "-o", "go.yaml"]
    run_command(0, *command)
    message = run_command(0, "settings", "interface=socketcan", "channel=can3").out
    assert "`virtual` in a procedure selects no bus" in message
    choices = choices_from(parser_of("run").parse_args(["go.yaml"]))
    opening = begin("go.yaml", choices, root=tmp_path)
    assert opening.procedure.bus.interface == "virtual"
    assert choices.bus(opening.procedure).interface == "socketcan"


def test_operator_is_journalled(file, tmp_path):
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
def test_invalid_file_is_one_error(file, run_command, text, approve):
    file.parent.mkdir(parents=True)
    file.write_text(text)
    for command in (["settings"], ["run", "hinge"], ["probe"]):
        message = run_command(2, *command).err
        assert str(file) in message
        approve(message)
    assert not Path("sessions").exists()


SETTINGS = "interface, channel, bitrate, theme, operator"


def test_invalid_setting_lists_the_valid_ones(file, run_command):
    for word, message in (
        ("interface", SETTINGS),
        ("colour=red", SETTINGS),
        ("=x", SETTINGS),
        ("theme=pink", "theme"),
        ("bitrate=" + 5000 * "9", "bitrate"),
        ("interface=bogus", "'bogus'"),
        ("interface=bogus", "loopback"),
        ("interface=bogus", "socketcan"),
    ):
        assert message in run_command(2, "settings", word).err
    assert not file.exists()
    for interface in ("loopback", "virtual", "slcan"):
        run_command(0, "settings", f"interface={interface}")


INVALID = "schema: sarcal/settings/1\ninterface: socketcan\ntheme: pink\nintreface: x\n"


@pytest.fixture
def invalid_file(file):
    file.parent.mkdir(parents=True)
    file.write_text(INVALID)
    return file


def test_invalid_file_is_corrected_key_by_key(invalid_file, run_command):
    assert f"{invalid_file}:4: intreface" in run_command(2, "settings", "theme=dark").err
    assert invalid_file.read_text() == INVALID
    run_command(0, "settings", "theme=dark", "intreface=")
    assert load_settings().stated == {"interface": "socketcan", "theme": "dark"}
    invalid_file.write_text("theme: dark\n")
    run_command(0, "settings", "operator=R. Hand")
    assert load_settings().stated == {"theme": "dark", "operator": "R. Hand"}
    other = "schema: sarcal/arm/1\nname: mine\n"
    invalid_file.write_text(other)
    run_command(2, "settings", "theme=dark", "name=")
    assert invalid_file.read_text() == other


def test_invalid_file_is_a_warning_with_a_given_bus(invalid_file, tmp_path, monkeypatch, capsys):
    choices = choices_from(parser_of("run").parse_args(["hinge", "-i", "virtual"]))
    message = " ".join(capsys.readouterr().err.split())
    assert f"{invalid_file} is invalid, and its theme and operator are not used" in message
    assert "`sarcal settings` shows what is wrong" in message
    assert choices.operator is None
    opening = begin("hinge", choices, root=tmp_path)
    assert choices.bus(opening.procedure).interface == "virtual"
    assert main(["reset"]) == 2
    reset = opening_from(parser_of("reset").parse_args(["-i", "loopback"]))
    assert reset.choices.bus(reset.procedure).interface == "loopback"
    monkeypatch.setenv("CAN_INTERFACE", "loopback")
    assert replace(choices, interface=None).bus(opening.procedure).interface == "loopback"
    capsys.readouterr()
    # A controller has no operator, and needs no warning.
    choices_from(parser_of("controller").parse_args([]), journal=False)
    assert capsys.readouterr().err == ""


def test_app_starts_with_an_invalid_file_and_warns(
    invalid_file, tmp_path, monkeypatch, run_command
):
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    message = run_command(0, "--plain", "-i", "virtual", "--sessions", tmp_path / "sessions").words
    assert f"warning] {invalid_file} is invalid" in message
    assert message.count(str(invalid_file)) == 1


@pytest.mark.parametrize(
    ("settings", "code", "words"),
    [
        ("interface: bogus", 2, "Use one of"),
        ("interface: socketcan", 2, "No channel is given"),
        ("interface: socketcan\nchannel: nosuchcan9", 3, "nosuchcan9|no CAN sockets"),
    ],
)
def test_error_of_the_bus_setting_names_the_file(file, run_command, settings, code, words):
    file.parent.mkdir(parents=True)
    file.write_text(f"schema: sarcal/settings/1\n{settings}\n")
    message = run_command(code, "probe").err
    assert str(file) in message
    assert any(word in message for word in words.split("|")), message
