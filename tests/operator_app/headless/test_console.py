"""What `sarcal run` writes to stderr during a run."""

import pytest

from hardware.arm import ArmIdentity
from operator_app.headless.console import ConsoleListener
from operator_app.messages.errors import connected_words
from operator_app.session.store.state import SessionState
from tests.oracles.plant_arm import node


@pytest.mark.parametrize(
    ("second_name", "nodes"),
    [("sarcal virtual supervisor", "2 simulated CANopen nodes"), ("a drive", "2 CANopen nodes")],
)
def test_simulated_nodes_are_reported_as_simulated(second_name, nodes):
    identities = (node(1, 1, "sarcal virtual joint drive"), node(2, 2, second_name))
    arm = ArmIdentity(model="an_arm", serial_number="A-1", nodes=identities)
    assert connected_words(arm) == f"Connected to an_arm, serial A-1: {nodes}"


def test_each_pose_is_one_line(capsys):
    listener = ConsoleListener()
    for captured in (1, 2):
        listener.pose_captured(SessionState(captured=captured), 16)
    assert capsys.readouterr().err == "Pose 1 captured (0 of 16).\nPose 2 captured (0 of 16).\n"
