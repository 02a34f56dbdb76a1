"""What `sarcal reset` says: what stays once where it is the arm's, and joint by joint where it is theirs."""

import pytest

from operator_app.commands.reset import report

STOP, TORQUE = "external stop, contact 1 (5441h)", "excess torque (8311h)"


@pytest.mark.parametrize(
    "stays",
    [{}, dict.fromkeys(range(1, 8), STOP), {2: TORQUE, 5: TORQUE, 6: STOP}],
    ids=["nothing", "a stop contact that is still pressed", "some joints' own"],
)
def test_what_stays_is_said_once_of_the_arm_or_of_each_joint(stays, capsys, approve):
    report({}, stays, arm_joints=7, in_json=False)
    approve("".join(capsys.readouterr()))
