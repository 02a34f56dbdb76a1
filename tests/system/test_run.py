"""`sarcal run` over the bus: the whole way, in this process and in processes of its own."""

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
from tests.oracles.own_process import finished, start, wait_for_poses
from tests.oracles.parameter_documents import VALUES as TRUTH


def far_off_procedure(folder: Path) -> Path:
    """The packaged procedure with every nominal value 10 deg or 30 mm from the truth, signs mixed."""
    signs = iter(np.random.default_rng(5).choice([-1.0, 1.0], 14).tolist())
    arm = yaml.safe_load(resolve("arm", "sarcos_dextrous").data)
    fixture = yaml.safe_load(resolve("fixture", "hinge").data)
    procedure = yaml.safe_load(resolve("procedure", "hinge").data)
    for row in arm["dh"]:
        row["theta_off_deg"] = TRUTH[f"theta_off_{row['row']}"] + 10.0 * next(signs)
    for key in fixture["placement"]:
        name = key.replace("_n_", "_7_").rsplit("_", 1)[0]
        scale, off = (1.0, 10.0) if key.endswith("_deg") else (1e3, 30.0)
        fixture["placement"][key] = TRUTH[name] * scale + off * next(signs)
    procedure["arm"], procedure["fixture"] = "arm.yaml", "fixture.yaml"
    for name, document in (("arm", arm), ("fixture", fixture), ("procedure", procedure)):
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
    return folder / "procedure.yaml"


def test_exact_recovers_all_14_parameters_from_10_deg_and_30_mm_off(tmp_path, ends_with):
    procedure = far_off_procedure(tmp_path)
    options = ["--scenario", "exact", "--poses", "24", "--sessions", tmp_path / "sessions"]
    found = ends_with(0, "run", procedure, *options, "--json").json
    assert set(found["parameters"]) == set(TRUTH)
    for name, value in TRUTH.items():
        # The only error is the rounding of 400,000-count encoders. It is uniform, count^2/12, and
        # the estimator's own sigma follows from it: five of them are the bound. Along the weakest
        # direction that is 7e-5 rad and 3e-5 m.
        error = abs(found["parameters"][name] - value)
        assert error < 5.0 * found["sigma"][name], name
        angle = name.startswith(("theta", "alpha"))
        assert error < (np.rad2deg(7e-5) if angle else 3e-5), name
    assert found["rank"] == 14
    assert found["scaled_condition_number"] < 60
    # What the program says of the truth, from this file's own.
    inside = [low <= TRUTH[name] <= high for name, (low, high) in found["interval_95"].items()]
    assert (found["truth"]["inside_95"], found["truth"]["of"]) == (sum(inside), 14)
    assert found["truth"]["tool_mm_rms"] < 4.0 * found["truth"]["predicted_mm_rms"]

    folder = Path(found["session"]["folder"])
    document = (folder / "parameters.yaml").read_bytes()
    assert found["session"]["uploaded"]
    assert parse_parameters(document).arm.serial == found["session"]["serial_number"]
    assert {"journal.jsonl", "poses.csv", "parameters.yaml"} <= {p.name for p in folder.iterdir()}
    assert not read_journal(folder).torn

    # The poses file alone gives the same answer, bit for bit; `paper`, because the arm file says
    # RVDT where this arm carries encoders, and weights would differ.
    files = ["--arm", str(tmp_path / "arm.yaml"), "--fixture", str(tmp_path / "fixture.yaml")]
    csv = str(folder / "poses.csv")
    again = ends_with(0, "solve", csv, *files, "--estimator", "paper", "--json").json
    assert again["parameters"] == found["paper"]["parameters"]
    # A file of poses knows no truth; the journal keeps what was known.
    assert "truth" not in again
    assert ends_with(0, "report", folder, "--json").json["truth"] == found["truth"]


@pytest.mark.campaign
def test_as_reported_lands_where_the_paper_did(tmp_path, ends_with):
    options = ["--scenario", "as_reported", "--sessions", tmp_path]
    found = ends_with(4, "run", "hinge", *options, "--json").json
    paper = found["paper"]
    assert paper["sigma_pos_mm"]["rms"] == pytest.approx(2.7, rel=0.3)
    assert paper["sigma_ori_mrad"]["rms"] == pytest.approx(6.6, rel=0.3)
    assert found["scaled_condition_number"] < 60
    assert found["poses"] == 40
    assert any(w["code"].startswith("RVDT") for w in found["warnings"])


@pytest.mark.campaign
def test_a_run_is_the_same_for_a_seed(tmp_path, ends_with):
    def run(seed: int) -> dict:
        options = ["--poses", "4", "--seed", seed, "--sessions", tmp_path, "--json"]
        return ends_with(4, "run", "hinge", *options).json

    one, two, other = run(3), run(3), run(4)
    # What it printed is what its journal says to whoever asks later.
    reported = ends_with(4, "report", two["session"]["folder"], "--json").json
    assert reported == {k: two[k] for k in two if k != "capture"}
    assert one["parameters"] == two["parameters"]
    assert other["parameters"] != one["parameters"]


@pytest.mark.parametrize(
    "typed",
    [
        "run nowhere.yaml",
        "run hing",
        "run hinge --poses 2",
        "run hinge --unsensed 8",
        "run --resume nowhere",
        "run hinge --seed -1",
        "plan hing",
        "plan hinge --poses 0",
        "plan hinge --poses 50000",
        "plan hinge --arm nowhere.yaml",
        "plan hinge --fixture hing",
        "plan hinge --fixture rigid",
        "plan hinge --fixture ball",
        "plan hinge --unsensed 9",
        "plan hinge --advise --tries 0",
        "plan --session nowhere",
        "plan hinge --session latest",
    ],
)
def test_bad_input_says_what_to_do_and_writes_nothing(tmp_path, ends_with, typed, approve):
    said = ends_with(2, *typed.split(), "--sessions", tmp_path / "s")
    assert said.out == ""
    approve(said.err)
    assert not (tmp_path / "s").exists()


@pytest.mark.parametrize("command", [["run"], ["plan", "--poses", "4"]], ids=["run", "plan"])
def test_rigid_with_every_offset_free_is_refused_by_naming_joint_4(tmp_path, ends_with, command):
    procedure = yaml.safe_load(resolve("procedure", "rigid").data)
    del procedure["held"]
    mine = tmp_path / "rigid_all_free.yaml"
    mine.write_text(yaml.safe_dump(procedure, sort_keys=False))
    assert "joint 4 does not move" in ends_with(5, *command, mine, "--sessions", tmp_path).words


@pytest.mark.parametrize("placements", ["1", pytest.param("2", marks=pytest.mark.campaign)])
def test_an_arm_with_a_drive_that_stays_powered_is_not_called_held(
    tmp_path, ends_with, monkeypatch, placements
):
    """Between two placements somebody would reach into it."""
    obey = Drive.obey_controlword

    def stay_on(drive: Drive, word: int) -> None:
        on = drive.state is DriveState.OPERATION_ENABLED
        if not (drive.axis.joint == 1 and on and word == 0x0000):
            obey(drive, word)

    monkeypatch.setattr(Drive, "obey_controlword", stay_on)
    asked = ["run", "hinge", "--poses", "4", "--placements", placements, "--json"]
    said = ends_with(3, *asked, "--sessions", tmp_path)
    assert "the drive of joint 1 is still powered" in said.err
    assert "Keep clear" in said.err
    assert "hardware stop" in said.err
    assert "arm is held" not in said.err
    assert "Placement 2 of 2" not in said.err
    if placements == "1":
        assert said.json["poses"] == 4, "what was found is said all the same"
    (folder,) = tmp_path.iterdir()
    assert read_journal(folder).events[-1].name == "closed"


@pytest.mark.campaign
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_it_holds_the_arm_and_resumes(tmp_path, number):
    process = start(tmp_path, "run", "hinge", "--poses", "30")
    folder = wait_for_poses(tmp_path / "sessions", 3, process)
    process.send_signal(number)
    said = finished(process, 130, patience_s=30.0).err
    assert "the arm is held" in said
    assert "--resume" in said
    contents = read_journal(folder)
    assert not contents.torn
    assert contents.events[-1].name == "closed"
    kept = sum(e.name == "pose" for e in contents.events)
    assert kept >= 3

    done = finished(start(tmp_path, "run", "--resume", "latest", "--json"), 0)
    assert done.json["poses"] == 30
    numbers = [e.data["number"] for e in read_journal(folder).events if e.name == "pose"]
    assert numbers == list(range(1, 31))
