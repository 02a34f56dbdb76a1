"""`sarcal run` over the bus, from Connect to Export, in this process and in processes of its own."""

import signal
from pathlib import Path

import numpy as np
import pytest
import yaml

from hardware.arm import DriveState
from hardware.virtual.drive import Drive
from operator_app.config.parameters_file import parse_parameters
from operator_app.config.resources import resolve
from operator_app.session.store.journal import read_journal
from tests.benchmarks.shop_floor_files import written
from tests.oracles.journal_events import event_data
from tests.oracles.own_process import finished, start, wait_for_poses
from tests.oracles.parameter_documents import VALUES as TRUE_VALUES


def procedure_far_from_truth(folder: Path) -> Path:
    """Write the packaged procedure with every nominal value 10 deg or 30 mm from the true one, of either sign."""
    signs, nominal = np.random.default_rng(5).choice([-1, 1], 14), {}
    for sign, (name, value) in zip(signs, TRUE_VALUES.items(), strict=True):
        angle = name.startswith(("theta_off", "alpha"))
        nominal[name] = np.deg2rad(value + 10.0 * sign) if angle else value + 0.030 * sign
    procedure = yaml.safe_load(resolve("procedure", "hinge").data)
    procedure |= {"arm": "arm.yaml", "fixture": "fixture.yaml"}
    documents = (*written(nominal), yaml.safe_dump(procedure, sort_keys=False).encode())
    for name, document in zip(("arm", "fixture", "procedure"), documents, strict=True):
        (folder / f"{name}.yaml").write_bytes(document)
    return folder / "procedure.yaml"


def test_exact_arm_is_recovered_from_10_deg_and_30_mm_off(tmp_path, run_command):
    procedure = procedure_far_from_truth(tmp_path)
    options = ["--scenario", "exact", "--poses", "24", "--sessions", tmp_path / "sessions"]
    result = run_command(0, "run", procedure, *options, "--json").json
    assert set(result["parameters"]) == set(TRUE_VALUES)
    for name, value in TRUE_VALUES.items():
        # The only error is the rounding of 400,000-count encoders: uniform, variance count^2/12. In the
        # least determined direction five sigmas are 7e-5 rad and 3e-5 m.
        error = abs(result["parameters"][name] - value)
        assert error < 5.0 * result["sigma"][name], name
        angle = name.startswith(("theta", "alpha"))
        assert error < (np.rad2deg(7e-5) if angle else 3e-5), name
    assert result["rank"] == 14
    assert result["scaled_condition_number"] < 60
    inside = [
        low <= TRUE_VALUES[name] <= high for name, (low, high) in result["interval_95"].items()
    ]
    assert (result["truth"]["inside_95"], result["truth"]["of"]) == (sum(inside), 14)
    assert result["truth"]["tool_mm_rms"] < 4.0 * result["truth"]["predicted_mm_rms"]

    folder = Path(result["session"]["folder"])
    document = (folder / "parameters.yaml").read_bytes()
    assert result["session"]["uploaded"]
    assert parse_parameters(document).arm.serial == result["session"]["serial_number"]
    assert {"journal.jsonl", "poses.csv", "parameters.yaml"} <= {p.name for p in folder.iterdir()}
    assert not read_journal(folder).torn

    # The poses file alone gives the same result, bit for bit. The estimator is `paper`: the arm file states
    # RVDTs where this arm has encoders, so that weights would differ.
    files = ["--arm", str(tmp_path / "arm.yaml"), "--fixture", str(tmp_path / "fixture.yaml")]
    solved = run_command(
        0, "solve", folder / "poses.csv", *files, "--estimator", "paper", "--json"
    ).json
    assert solved["parameters"] == result["paper"]["parameters"]
    # The journal has the true values, a poses file has not.
    assert "truth" not in solved
    assert run_command(0, "report", folder, "--json").json["truth"] == result["truth"]


@pytest.mark.campaign
def test_runs_with_one_seed_are_identical(tmp_path, run_command):
    def run(seed: int) -> dict:
        options = ["--poses", "4", "--seed", seed, "--sessions", tmp_path, "--json"]
        return run_command(4, "run", "hinge", *options).json

    first, second = run(3), run(3)
    report = run_command(4, "report", second["session"]["folder"], "--json").json
    assert report == {key: second[key] for key in second if key != "capture"}
    assert first["parameters"] == second["parameters"]
    assert run(4)["parameters"] != first["parameters"]


@pytest.mark.parametrize("command", [["run"], ["plan", "--poses", "4"]], ids=["run", "plan"])
def test_rigid_fixture_with_every_offset_free_is_refused(tmp_path, run_command, command):
    procedure = yaml.safe_load(resolve("procedure", "rigid").data)
    del procedure["held"]
    path = tmp_path / "rigid_all_free.yaml"
    path.write_text(yaml.safe_dump(procedure, sort_keys=False))
    assert "joint 4 does not move" in run_command(5, *command, path, "--sessions", tmp_path).words


@pytest.mark.parametrize("placements", ["1", pytest.param("2", marks=pytest.mark.campaign)])
def test_arm_with_a_powered_drive_is_not_reported_as_held(
    tmp_path, run_command, monkeypatch, placements
):
    """Between two placements the operator reaches into the arm."""
    obey = Drive.obey_controlword

    def ignore_disable(drive: Drive, word: int) -> None:
        enabled = drive.state is DriveState.OPERATION_ENABLED
        if not (drive.axis.joint == 1 and enabled and word == 0x0000):
            obey(drive, word)

    monkeypatch.setattr(Drive, "obey_controlword", ignore_disable)
    options = ["--poses", "4", "--placements", placements, "--sessions", tmp_path, "--json"]
    answer = run_command(3, "run", "hinge", *options)
    assert "the drive of joint 1 is still powered" in answer.err
    assert "Keep clear" in answer.err
    assert "hardware stop" in answer.err
    assert "arm is held" not in answer.err
    assert "Placement 2 of 2" not in answer.err
    if placements == "1":
        assert answer.json["poses"] == 4
    (folder,) = tmp_path.iterdir()
    assert read_journal(folder).events[-1].name == "closed"


@pytest.mark.campaign
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_run_holds_the_arm_and_can_be_resumed(tmp_path, number):
    process = start(tmp_path, "run", "hinge", "--poses", "30")
    folder = wait_for_poses(tmp_path / "sessions", 3, process)
    process.send_signal(number)
    errors = finished(process, 130).err
    assert "the arm is held" in errors
    assert "--resume" in errors
    contents = read_journal(folder)
    assert not contents.torn
    assert contents.events[-1].name == "closed"
    assert len(event_data(folder, "pose")) >= 3

    resumed = finished(start(tmp_path, "run", "--resume", "latest", "--json"), 0)
    assert resumed.json["poses"] == 30
    assert [pose["number"] for pose in event_data(folder, "pose")] == list(range(1, 31))
