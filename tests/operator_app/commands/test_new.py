"""`sarcal new`: complete files, whose geometry a second chain confirms."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from operator_app.cli import main
from operator_app.config.fixture_file import load_fixture
from operator_app.config.procedure_file import load_procedure
from tests.oracles.json_schema import complaints
from tests.oracles.loop_oracle import product
from tests.oracles.panda import A_M, ALPHA_RAD, S_M
from tests.oracles.urdfs import joint, robot

HOME_DEG = np.array([0.0, -45.0, 0.0, -135.0, 0.0, 90.0, 45.0])


@pytest.fixture(autouse=True)
def working_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def flange_pose(q_deg: np.ndarray) -> np.ndarray:
    return product(np.deg2rad(q_deg), S_M, A_M, ALPHA_RAD)


def joined(vector: np.ndarray) -> str:
    return ",".join(repr(float(v)) for v in vector)


def hinge_error(file: str, q_deg: np.ndarray) -> tuple[float, float]:
    """Distance (m) and angle (rad) by which the chain of rows 0 to 7 misses its own z axis."""
    placement = {
        k.rpartition("_")[0]: np.deg2rad(v) if k.endswith("_deg") else v / 1e3
        for k, v in yaml.safe_load(Path(file).read_text())["placement"].items()
    }
    theta, s, a, alpha = (
        np.append(0.0, column) for column in (np.deg2rad(q_deg), S_M, A_M, ALPHA_RAD)
    )
    theta[1] += placement["theta_off_1"]
    theta[7] += placement["theta_off_n"]
    s[[0, 1, 7]] = [placement[k] for k in ("s_0", "s_1", "s_n")]
    a[[0, 7]] = [placement[k] for k in ("a_0", "a_n")]
    alpha[[0, 7]] = [placement[k] for k in ("alpha_0", "alpha_n")]
    T = product(theta, s, a, alpha)
    return float(np.linalg.norm(T[:3, 3])), float(np.arccos(np.clip(T[2, 2], -1.0, 1.0)))


@pytest.mark.parametrize("seed", range(6))
def test_hinge_from_two_measured_lines_closes_where_they_coincide(seed):
    rng = np.random.default_rng(seed)
    point, direction = rng.uniform(-150.0, 150.0, 3), rng.normal(size=3)
    q_deg = HOME_DEG + rng.uniform(-8.0, 8.0, 7)
    T = flange_pose(q_deg)
    # The same point of the axis, as a hinge does not slide; the direction in either sense.
    ground = 1e3 * T[:3, 3] + T[:3, :3] @ point
    base_direction = T[:3, :3] @ direction * rng.choice((-2.0, 0.5))
    options = [f"--hand-point={joined(point)}", f"--hand-direction={joined(direction)}"]
    base = [f"--base-point={joined(ground)}", f"--base-direction={joined(base_direction)}"]
    new = ["new", "fixture", "--kind", "hinge", "--arm", "franka_panda", "--name"]
    assert main([*new, "there", *options, *base]) == 0
    # The file is rounded to 0.01 mm and 0.001 deg.
    assert max(hinge_error("there.yaml", q_deg)) < 1e-4
    assert main([*new, "home", *options]) == 0
    assert max(hinge_error("home.yaml", HOME_DEG)) < 1e-4


def test_ball_is_placed_at_the_tool_point(run_command):
    new = ["new", "fixture", "--kind", "ball", "--arm", "franka_panda", "--hand-point=30,-20,55.5"]
    run_command(0, *new, "--name", "home", "--tolerance-mm", "2")
    ball = load_fixture("home.yaml").fixture
    expected = flange_pose(HOME_DEG) @ [0.03, -0.02, 0.0555, 1.0]
    np.testing.assert_allclose(ball.ground_m, expected[:3], atol=1e-5)  # type: ignore[attr-defined]
    assert ball.tolerance.position_m == pytest.approx(2e-3)
    run_command(0, *new, "--name", "there", "--base-point=400,10,20")
    np.testing.assert_allclose(load_fixture("there.yaml").fixture.ground_m, [0.4, 0.01, 0.02])  # type: ignore[attr-defined]


def test_new_files_match_the_schema_written_beside_them(run_command):
    Path("files").mkdir()
    run_command(0, "new", "arm", "--from", "franka_panda", "--name", "mine", "-o", "files/arm.yaml")
    run_command(0, "new", "fixture", "--from", "ball", "-o", "files/ball.yaml")
    options = ["--arm", "files/arm.yaml", "--fixture", "files/ball.yaml"]
    output = run_command(
        0, "new", "procedure", *options, "--name", "go", "-o", "files/run.yaml"
    ).out
    run_command(0, "new", "procedure", "--from", "hinge", "--name", "copy", "-o", "files/copy.yaml")
    for file, kind, name in (
        ("arm", "arm", "mine"),
        ("ball", "fixture", "my_ball"),
        ("run", "procedure", "go"),
        ("copy", "procedure", "copy"),
    ):
        text = Path(f"files/{file}.yaml").read_text()
        schema = f"sarcal-{kind}.schema.json"
        assert text.startswith(f"# yaml-language-server: $schema={schema}\n")
        data = yaml.safe_load(text)
        assert data["name"] == name
        schema = json.loads(Path("files", schema).read_text())
        assert list(complaints(data, schema, schema)) == []
    procedure = load_procedure("files/run.yaml")
    assert procedure.arm.name == "mine"
    # Free in the arm, but not identifiable with a ball (paper, 2.1).
    assert set(procedure.held) == {"theta_off_1", "theta_off_7"}
    assert "theta_off_7 is fixed: " in output
    text = Path("files/run.yaml").read_text()
    assert "virtual is a simulated one" not in text
    assert "virtual takes the bus of the environment, can.conf or your settings" in text
    before = Path("files/arm.yaml").read_bytes()
    run_command(2, "new", "arm", "--from", "sarcos_dextrous", "-o", "files/arm.yaml")
    assert Path("files/arm.yaml").read_bytes() == before
    options = ["--arm", "franka_panda", "--fixture", "tracker", "--name", "open"]
    run_command(0, "new", "procedure", *options)
    assert load_procedure("open.yaml").position_joints == (1, 2, 3, 4, 5, 6, 7)


def test_limits_that_a_urdf_does_not_state_are_listed(run_command):
    joints = (joint(f"j{k}", f"l{k}", f"l{k + 1}", axis=f"{k} 1 0", velocity=k) for k in range(3))
    Path("arm.urdf").write_text(robot(*joints))
    text = run_command(0, "new", "arm", "--urdf", "arm.urdf").out + Path("arm.yaml").read_text()
    assert text.count("j0: no velocity") == text.count(": no ") == 2
    assert text.count("Assumed: a speed of 90 deg/s.") == 2


def test_unwritable_schema_leaves_no_file(tmp_path, run_command):
    (tmp_path / "sarcal-arm.schema.json").mkdir()
    message = run_command(2, "new", "arm", "--from", "ur5e", "-o", "mine.yaml").err
    assert "sarcal-arm.schema.json: cannot be written" in message
    (tmp_path / "sarcal-arm.schema.json").rmdir()
    run_command(0, "new", "arm", "--from", "ur5e", "-o", "mine.yaml")


@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("arm", "give --urdf FILE or --from NAME"),
        ("arm --from franka_panda --kind ball", "--kind is not an option of sarcal new arm"),
        ("arm --from nobody", "did you mean|is neither a built-in arm"),
        ("fixture --kind hinge", "--kind, --arm and the measured --hand-point"),
        ("fixture --from hinge --kind ball", "leave --kind out"),
        ("fixture --kind hinge --arm franka_panda --hand-point 1,2,3", "--hand-direction is missing"),
        ("fixture --kind hinge --arm franka_panda --hand-point 1,2 --hand-direction 1,0,0", "three numbers"),
        ("fixture --kind hinge --arm franka_panda --hand-point 1,2,3 --hand-direction 0,0,0", "cannot be 0,0,0"),
        ("fixture --kind ball --arm franka_panda --hand-point 1,2,nan", "three numbers"),
        ("fixture --kind ball --arm franka_panda --hand-point 1,2,3 --hand-direction 1,0,0", "is a point"),
        ("fixture --kind ball --arm franka_panda --hand-point 1,2,3 --tolerance-mm -1", "tolerance_mm"),
        ("fixture --kind ball --arm franka_panda --hand-point 1,2,3 --tolerance-mm nan", "not a finite number"),
        ("fixture --kind ball --arm franka_panda --hand-point 1,2,3 --tolerance-deg 1e999", "not a finite number"),
        ("procedure --arm franka_panda", "give --arm and --fixture"),
        ("procedure --from hinge --name 7", "begin with a letter"),
        pytest.param(f"arm --from ur5e -o {'a' * 5000}", "cannot be written: File name too long", id="long"),
    ],
)  # fmt: skip
def test_invalid_options_are_refused_and_nothing_is_written(typed, expected, run_command):
    message = run_command(2, "new", *typed.split()).err
    assert any(part in message for part in expected.split("|")), message
    assert message.count("sarcal") == 1 + expected.count("sarcal"), "the program's name occurs once"
    assert not list(Path().iterdir())


# Without "./", the last two name a shipped arm and a home folder.
@pytest.mark.parametrize(
    "file",
    ["arm.yaml", "a #x.yaml", r"a\1 #x", r"C:\gx", "'a': b", "é, ☃.yaml", "./ur5e", "./~root"],
)
def test_copied_procedure_refers_to_the_given_arm_file(file):
    assert main(["new", "arm", "--from", "franka_panda", "--name", "mine", "-o", file]) == 0
    assert main(["new", "procedure", "--from", "hinge", "--arm", file, "-o", "go.yaml"]) == 0
    assert load_procedure("go.yaml").arm.name == "mine"
    assert yaml.safe_load(Path("go.yaml").read_text())["arm"] == file
    if file == "arm.yaml":
        assert "\narm: arm.yaml\n" in Path("go.yaml").read_text()


def test_command_advised_for_a_fixture_out_of_reach_can_be_run(run_command):
    options = ["--arm", "franka_panda", "--kind", "ball", "--hand-point", "0,0,100"]
    output = run_command(0, "new", "fixture", *options, "--base-point", "5000,0,0").out
    (command,) = (
        line.rpartition(": sarcal ")[2] for line in output.splitlines() if "closes:" in line
    )
    assert "No problems were found" in run_command(5, *command.split()).out
