"""An arm offered by another package: selected by name, calibrated, and named in errors when it is defective."""

import json
import socket
import sys
from contextlib import closing, suppress
from importlib import import_module
from pathlib import Path
from threading import Thread

import pytest
from sarcal import arms

from hardware.arm_plugins import offer
from hardware.errors import BusError
from operator_app.composition import describe
from operator_app.config.arm_file import load_arm
from operator_app.session.store.journal import read_journal
from tests.oracles.toy_arm import PROCEDURE, package, toy


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """The files of the manual's example package, installed beside it."""
    folder = tmp_path_factory.mktemp("plugin") / "package"
    package(folder)
    return folder


@pytest.fixture
def workspace(example, tmp_path, monkeypatch):
    """Current folder with a procedure; the example package can be imported."""
    monkeypatch.syspath_prepend(example.with_name(example.name + "-installed"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quick.yaml").write_text(PROCEDURE)
    return tmp_path


@pytest.mark.campaign
def test_plugin_arm_is_calibrated_by_name(workspace, example, run_command, monkeypatch):
    with toy(example) as arm:
        bus = ["-i", "moving_line_arm", "-c", arm.channel]
        answer = run_command(0, "run", "quick.yaml", *bus, "--json")
        assert (
            "Connected to sarcos_dextrous, serial TOY-0001: 7 simulated JSON nodes." in answer.err
        )
        result = answer.json
        assert result["verdict"].startswith("accepted")
        assert "truth" not in result  # true values are known of an embedded virtual arm only
        # The true values of seed 0.
        assert result["parameters"]["theta_off_2"] == pytest.approx(-122.8, abs=0.5)
        assert result["parameters"]["s_1"] == pytest.approx(0.273, abs=0.003)
        session = Path(result["session"]["folder"])
        settings = read_journal(session).events[0].data["settings"]
        assert (settings["interface"], settings["channel"]) == ("moving_line_arm", arm.channel)
        # This arm has no parameter store.
        assert (session / "parameters.yaml").is_file()
        assert result["session"]["uploaded"] is False
        # Resuming needs no bus options: the journal has them.
        assert "serial TOY-0001" in run_command(0, "run", "--resume", "latest", "--json").err
    # A report needs neither the arm nor its package.
    monkeypatch.setattr("sys.path", [p for p in sys.path if not p.endswith("-installed")])
    run_command(0, "report", "latest")
    errors = run_command(2, "run", "--resume", "latest").err
    assert 'Unknown interface type "moving_line_arm"' in errors


@pytest.mark.parametrize(
    ("options", "code"),
    [
        (["-i", "line_arm"], 3),
        (["-i", "line_arm", "-c", "127.0.0.1:1"], 3),
        (["-i", "line_arms"], 2),
        (["-i", "line_arm", "-c", "here:1", "--record"], 2),
    ],
)
def test_wrong_plugin_options_are_one_error(workspace, run_command, options, code, approve):
    approve(run_command(code, "run", "quick.yaml", *options).err)
    assert not list(workspace.glob("sessions/*"))


def test_can_command_refuses_a_plugin_arm(workspace, run_command):
    command = ["monitor", "-i", "line_arm", "-c", "here:1", "--seconds", "1"]
    assert "line_arm is an arm of an installed package" in run_command(3, *command).err


def example_arm(name: str, channel: str) -> arms.Arm:
    """Return the example package's arm without our wrapper."""
    order = arms.ArmOrder(description=describe(load_arm("sarcos_dextrous")), channel=channel)
    return import_module(name).OFFER.make(order)


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["line_arm", "moving_line_arm"])
def test_example_arm_closes_its_socket_after_link_loss(workspace, example, name):
    with toy(example) as simulator:
        arm = example_arm(name, simulator.channel)
        arm.connect()
    with pytest.raises(arms.BusError, match="is silent"):
        arm.capture(100_000)
    assert not arm.close()
    assert arm._socket.fileno() == -1


def test_stop_returns_when_peer_reads_nothing(workspace):
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        arm = example_arm("moving_line_arm", f"127.0.0.1:{server.getsockname()[1]}")

        def send_only() -> None:
            sample = {"deg": [0.0] * 7, "modes": ["position"] * 7, "enabled": False}
            line = json.dumps(sample | {"done": 10**9, "why": ""}).encode() + b"\n"
            connection, _ = server.accept()
            with closing(connection), suppress(OSError):
                connection.sendall(b'{"serial": "DEAF-1"}\n')
                while True:
                    connection.sendall(line)

        Thread(target=send_only, daemon=True).start()
        arm.connect()
        arm._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)

        def stop_repeatedly() -> None:
            for _ in range(100_000):
                arm.stop()

        # Pytest's own timeout ends a stop that never returns.
        message = r"takes no commands: nothing was read there for 0\.2 s"
        with pytest.raises(arms.BusError, match=message):
            stop_repeatedly()
        assert not arm.close()


@pytest.fixture
def install(workspace, monkeypatch):
    """Install another package with an arm: its entry point and the code of its module."""

    def install_package(name: str, code: str) -> None:
        site = workspace / "site"
        info = site / f"{name}_pkg-1.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}-pkg\nVersion: 1\n")
        (info / "entry_points.txt").write_text(f"[sarcal.arm]\n{name} = {name}_module:OFFER\n")
        (site / f"{name}_module.py").write_text(code)
        monkeypatch.syspath_prepend(site)

    return install_package


DEFECTIVE_ARM = """\
from sarcal.arms import ArmOffer
from tests.oracles.plant_arm import PlantArm
from operator_app.config.procedure_file import load_procedure

class Broken(PlantArm):
    def capture(self, samples):
        raise KeyError("deg")

OFFER = ArmOffer(make=lambda order: Broken(load_procedure("hinge"), "exact"), says="breaks")
"""


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("nothing", "import no_such_library\n"),
        ("text", "OFFER = 'an arm'\n"),
        ("broken", DEFECTIVE_ARM),
    ],
    ids=["nothing", "text", "broken"],
)
def test_defective_plugin_is_named(install, run_command, name, code, approve):
    install(name, code)
    approve(run_command(3, "run", "quick.yaml", "-i", name).err)


def test_plugin_replaces_no_interface_and_no_other_plugin(install):
    install("socketcan", "OFFER = 1\n")
    assert offer("socketcan") is None
    install("line_arm", "OFFER = 1\n")
    with pytest.raises(BusError, match="line_arm-pkg and sarcal-line-arm"):
        offer("line_arm")


def test_help_does_not_overwrite_example_files(example, run_command):
    errors = run_command(2, "help", "outside-arm", "--files", example).err
    assert "pyproject.toml exists already" in errors
    assert "these do: " in run_command(2, "help", "sign", "--files", example).err
    assert len((example / "line_arm.py").read_text().splitlines()) <= 150
