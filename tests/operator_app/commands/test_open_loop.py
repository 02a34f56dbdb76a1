"""`sarcal verify --open-loop`: another instrument agrees with a sound calibration, and names what does not."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from operator_app.cli import main
from tests.oracles.approved import Approve
from tests.oracles.open_arm import measured_csv


def judged(
    folder: Path, csv: Path, capsys: pytest.CaptureFixture[str], *more: str
) -> tuple[int, dict]:
    capsys.readouterr()
    code = main(["verify", str(folder), str(csv), "--open-loop", "--json", *more])
    return code, json.loads(capsys.readouterr().out)


def test_an_arm_that_is_what_was_found_agrees(
    journalled: Mapping[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    csv = measured_csv(tmp_path / "open.csv")
    code, found = judged(journalled["run"], csv, capsys)
    assert (code, found["verdict"], found["disagree"]) == (0, "agrees", [])
    assert found["poses"] == 40
    assert {"theta_off_1", "theta_off_7"} == set(found["not_compared"])
    compared = found["parameters"]
    assert {f"theta_off_{j}" for j in range(2, 7)} < set(compared)
    for name, value in (("theta_off_2", -122.8), ("theta_off_5", 27.1), ("s_5", 0.320)):
        row = compared[name]
        assert abs(row["open_loop"] - value) < 3.0 * row["sigma"], name


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("planted", "name", "size"),
    [
        ({"wrong_rad": {3: np.deg2rad(1.0)}}, "theta_off_3", 1.0),
        ({"longer_m": {5: 0.010}}, "s_5", 0.010),
    ],
)
def test_what_disagrees_is_named(
    journalled: Mapping[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    planted: dict,
    name: str,
    size: float,
) -> None:
    csv = measured_csv(tmp_path / "open.csv", **planted)
    code, found = judged(journalled["run"], csv, capsys)
    assert (code, found["verdict"], found["disagree"]) == (4, "disagrees", [name])
    row = found["parameters"][name]
    assert abs(row["change"] - size) < 3.0 * row["sigma"]
    assert main(["verify", str(journalled["run"]), str(csv), "--open-loop"]) == 4
    assert f"of {name}." in " ".join(capsys.readouterr().out.split())


def test_an_instrument_worse_than_its_file_says_proves_nothing(
    journalled: Mapping[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    csv = measured_csv(tmp_path / "open.csv", sigma_m=5e-3)
    code, found = judged(journalled["run"], csv, capsys)
    assert (code, found["verdict"]) == (4, "open loop not accepted")
    assert found["reasons"]


@pytest.mark.parametrize(
    "arguments",
    [
        ["{csv}"],
        ["--open-loop", "--procedure", "hinge"],
        ["--open-loop", "--tracker", "lab"],
        ["{csv}", "--open-loop", "--instrument", "hinge"],
    ],
)
def test_endpoints_are_never_ignored_in_silence(
    journalled: Mapping[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    approve: Approve,
) -> None:
    csv = measured_csv(tmp_path / "open.csv")
    given = [text.format(csv=csv) for text in arguments]
    assert main(["verify", str(journalled["run"]), *given]) == 2
    approve(capsys.readouterr().err)


@pytest.mark.campaign
def test_on_the_arm_out_of_its_hinge_it_is_judged_by_the_tracker(
    journalled: Mapping[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--open-loop", "--json", "--poses", "8", "--sessions", str(tmp_path)]
    code = main(["verify", str(journalled["run"]), *given])
    told = capsys.readouterr()
    found = json.loads(told.out)
    assert (code, found["verdict"], found["disagree"], found["poses"]) == (0, "agrees", [], 8)
    for name, planted in (("theta_off_2", -122.8), ("theta_off_5", 27.1)):
        row = found["parameters"][name]
        assert abs(row["open_loop"] - planted) < 4.0 * row["sigma"], name
    (folder,) = tmp_path.iterdir()
    assert f"kept in {folder}" in told.err
