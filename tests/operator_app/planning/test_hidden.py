"""What a fixture's own place hides is no unknown of a plan: it would make every sigma infinite or absurd."""

from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.planning.task import planning_task


def test_a_ball_hides_the_first_and_the_last_offset_and_a_hinge_none():
    arm = load_arm("franka_panda")
    ball = planning_task(arm, load_fixture("ball").fixture, drive_sets=None)
    assert {p.name for p in ball.model.parameters} == {
        *(f"theta_off_{j}" for j in range(2, 7)),
        *(f"{side}_{axis}" for side in ("tip", "ground") for axis in "xyz"),
    }
    assert set(ball.parameters or ()) == {p.name for p in ball.model.parameters}
    hinge = planning_task(arm, load_fixture("hinge").fixture, drive_sets=None)
    assert {"theta_off_1", "theta_off_7"} < {p.name for p in hinge.model.parameters}
