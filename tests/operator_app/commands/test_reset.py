"""`sarcal reset`: remaining faults, once for the whole arm or by joint."""

import pytest

from operator_app.commands.reset import report

STOP, TORQUE = "external stop, contact 1 (5441h)", "excess torque (8311h)"


@pytest.mark.parametrize(
    "remaining",
    [{}, dict.fromkeys(range(1, 8), STOP), {2: TORQUE, 5: TORQUE, 6: STOP}],
    ids=["nothing", "a stop contact that is still pressed", "some joints' own"],
)
def test_remaining_faults_are_reported_for_arm_or_joint(remaining, capsys, approve):
    report({}, remaining, arm_joints=7, in_json=False)
    approve("".join(capsys.readouterr()))
