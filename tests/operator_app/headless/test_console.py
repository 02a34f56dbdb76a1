"""What `sarcal run` says on stderr while it goes."""

import pytest

from hardware.arm import ArmIdentity
from operator_app.headless.console import ConsoleListener
from operator_app.session.store.state import SessionState
from tests.oracles.plant_arm import node


@pytest.mark.parametrize(
    ("names", "nodes"),
    [
        (("sarcal virtual joint drive", "sarcal virtual supervisor"), "2 simulated CANopen nodes."),
        (("sarcal virtual joint drive", "a drive"), "2 CANopen nodes."),
    ],
)
def test_a_simulated_arm_is_said_to_be_one(names, nodes, capsys):
    """Who named no bus must not take it for the arm beside the desk."""
    found = tuple(node(k, k, name) for k, name in enumerate(names, 1))
    listener = ConsoleListener()
    listener.connected(ArmIdentity(model="an_arm", serial_number="A-1", nodes=found))
    assert capsys.readouterr().err == f"Connected to an_arm, serial A-1: {nodes}\n"


def test_each_pose_is_a_line_where_stderr_is_no_screen(capsys):
    listener = ConsoleListener()
    for captured in (1, 2):
        listener.pose_captured(SessionState(captured=captured), 16)
    assert capsys.readouterr().err == ("Pose 1 captured (0 of 16).\nPose 2 captured (0 of 16).\n")
