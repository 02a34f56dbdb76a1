"""An arm that another package offers: found by name, run from Connect to the files, and named when it breaks."""

import json
import socket
import sys
from contextlib import closing, suppress
from importlib import import_module
from pathlib import Path
from threading import Thread

import pytest
from sarcal import arms

from operator_app.composition import describe
from operator_app.config.arm_file import load_arm
from operator_app.session.store.journal import read_journal
from tests.oracles.toy_arm import PROCEDURE, package, toy


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("outside") / "package"
    package(made)
    return made


@pytest.fixture
def desk(folder, tmp_path, monkeypatch):
    """A folder to work in, with the package installed."""
    monkeypatch.syspath_prepend(folder.with_name(folder.name + "-installed"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "quick.yaml").write_text(PROCEDURE)
    return tmp_path


@pytest.mark.campaign
def test_it_is_calibrated_by_name(desk, folder, ends_with, monkeypatch):
    with toy(folder) as arm:
        bus = ["-i", "moving_line_arm", "-c", arm.channel]
        told = ends_with(0, "run", "quick.yaml", *bus, "--json")
        assert "Connected to sarcos_dextrous, serial TOY-0001: 7 simulated JSON nodes." in told.err
        found = told.json
        assert found["verdict"].startswith("accepted")
        assert "truth" not in found  # simulated or not: it is behind a wire
        # Oracle: the truth of seed 0, as test_run has it from the design.
        assert found["parameters"]["theta_off_2"] == pytest.approx(-122.8, abs=0.5)
        assert found["parameters"]["s_1"] == pytest.approx(0.273, abs=0.003)
        folder_of_it = Path(found["session"]["folder"])
        opened = read_journal(folder_of_it).events[0].data["settings"]
        assert (opened["interface"], opened["channel"]) == ("moving_line_arm", arm.channel)
        # Nobody there keeps parameters: written, not uploaded.
        assert (folder_of_it / "parameters.yaml").is_file()
        assert found["session"]["uploaded"] is False
        # The journal knows the arm by name, no option is needed; nothing is solved twice.
        assert "serial TOY-0001" in ends_with(0, "run", "--resume", "latest", "--json").err
    # A report needs no arm, nor the package it came from.
    monkeypatch.setattr("sys.path", [p for p in sys.path if not p.endswith("-installed")])
    ends_with(0, "report", "latest")
    assert (
        'Unknown interface type "moving_line_arm"' in ends_with(2, "run", "--resume", "latest").err
    )


@pytest.mark.parametrize(
    ("options", "code"),
    [
        (["-i", "line_arm"], 3),
        (["-i", "line_arm", "-c", "127.0.0.1:1"], 3),
        (["-i", "line_arms"], 2),
        (["-i", "line_arm", "-c", "here:1", "--record"], 2),
    ],
)
def test_what_is_wrong_is_one_error(desk, ends_with, options, code, approve):
    told = ends_with(code, "run", "quick.yaml", *options).err
    approve(told)
    assert "Traceback" not in told
    assert not list(desk.glob("sessions/*")), "nothing was begun"


def test_a_can_command_says_that_it_is_no_bus(desk, ends_with):
    words = ["monitor", "-i", "line_arm", "-c", "here:1", "--seconds", "1"]
    said = ends_with(3, *words).err
    assert "line_arm is an arm of an installed package" in said


def made(name: str, channel: str) -> arms.Arm:
    """Make the page's arm of this name, not wrapped in ours."""
    order = arms.ArmOrder(description=describe(load_arm("sarcos_dextrous")), channel=channel)
    found: arms.Arm = import_module(name).OFFER.make(order)
    return found


@pytest.mark.sample(1)
@pytest.mark.parametrize("name", ["line_arm", "moving_line_arm"])
def test_an_arm_whose_link_is_lost_closes_its_end(desk, folder, name):
    with toy(folder) as there:
        arm = made(name, there.channel)
        arm.connect()
    with pytest.raises(arms.BusError, match="is silent"):
        arm.capture(100_000)
    assert not arm.close()
    assert arm._socket.fileno() == -1


def test_stop_does_not_wait_for_a_side_that_reads_nothing(desk):
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        arm = made("moving_line_arm", f"127.0.0.1:{server.getsockname()[1]}")

        def talk() -> None:
            sample = {"deg": [0.0] * 7, "modes": ["position"] * 7, "enabled": False}
            line = json.dumps(sample | {"done": 10**9, "why": ""}).encode() + b"\n"
            connection, _ = server.accept()
            with closing(connection), suppress(OSError):
                connection.sendall(b'{"serial": "DEAF-1"}\n')
                while True:
                    connection.sendall(line)

        Thread(target=talk, daemon=True).start()
        arm.connect()
        arm._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        told: list[arms.BusError] = []

        def press() -> None:
            try:
                for _ in range(100_000):
                    arm.stop()
            except arms.BusError as error:
                told.append(error)

        presser = Thread(target=press, daemon=True)
        presser.start()
        presser.join(5.0)
        assert "takes no commands: nothing was read there for 0.2 s" in str(told[0])
        assert not arm.close()


def offered(folder: Path, name: str, code: str) -> None:
    """Install another package that offers an arm."""
    info = folder / f"{name}_pkg-1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}-pkg\nVersion: 1\n")
    (info / "entry_points.txt").write_text(f"[sarcal.arm]\n{name} = {name}_module:OFFER\n")
    (folder / f"{name}_module.py").write_text(code)


BROKEN = """\
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
    [("nothing", "import no_such_library\n"), ("text", "OFFER = 'an arm'\n"), ("broken", BROKEN)],
    ids=["nothing", "text", "broken"],
)
def test_a_package_that_is_wrong_is_named(
    desk, tmp_path, monkeypatch, ends_with, name, code, approve
):
    offered(tmp_path / "site", name, code)
    monkeypatch.syspath_prepend(tmp_path / "site")
    told = ends_with(3, "run", "quick.yaml", "-i", name).err
    approve(told)
    assert name in told


def test_a_name_of_pythoncans_goes_on_meaning_its_bus(desk, tmp_path, monkeypatch):
    from hardware.arm_plugins import offer

    offered(tmp_path / "site", "socketcan", "OFFER = 1\n")
    monkeypatch.syspath_prepend(tmp_path / "site")
    assert offer("socketcan") is None


def test_two_packages_of_one_name_are_named(desk, tmp_path, monkeypatch):
    from hardware.arm_plugins import offer
    from hardware.errors import BusError

    offered(tmp_path / "site", "line_arm", "OFFER = 1\n")
    monkeypatch.syspath_prepend(tmp_path / "site")
    with pytest.raises(BusError, match="line_arm-pkg and sarcal-line-arm"):
        offer("line_arm")


def test_the_files_of_a_page_go_over_no_other_file(desk, folder, ends_with):
    assert (
        "pyproject.toml exists already"
        in ends_with(2, "help", "outside-arm", "--files", folder).err
    )
    assert "these do: " in ends_with(2, "help", "sign", "--files", folder).err
    assert len((folder / "line_arm.py").read_text().splitlines()) <= 150
