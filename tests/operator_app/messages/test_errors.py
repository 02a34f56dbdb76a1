"""Texts of errors: what happened, then the remedy."""

import pytest

from fixtures.errors import FixtureError
from hardware.canopen.objects import emergency_text
from hardware.errors import (
    BusError,
    ControlDenied,
    DriveFault,
    DuplicateNodeId,
    HostLatencyExceeded,
    NodeMissing,
    NodeRestarted,
    OtherMaster,
    SensorFault,
    WrongArm,
)
from operator_app.errors import SessionError
from operator_app.messages.errors import REMEDIES, words
from solver.errors import TooFewPosesError, UnidentifiableDirection, UnidentifiableError

UNIDENTIFIABLE = UnidentifiableDirection(parameters=("theta_off_3", "alpha_3"), weights=(0.8, 0.6))
TRIPS = 0x5441, 0x5442, 0x7305, 0x8130, 0x8311, 0x8611, 0x4210
STUCK = (
    "reads the same count as at pose 4, but according to the other joints it has turned by about 12 deg: "
    "its sensor is stuck. "
    "Poses with this reading are excluded. Repair the sensor, or calibrate without it: --unsensed 3"
)


@pytest.mark.parametrize(
    "error",
    [
        BusError("The arm has gone silent: no heartbeat from node 3"),
        NodeMissing((3, 5)),
        WrongArm("this is an arm of six joints"),
        ControlDenied(127),
        HostLatencyExceeded(3, 0.4),
        OtherMaster("Another program commands this arm. End that program, then connect again."),
        NodeRestarted((5,), ["joint 5"]),
        DuplicateNodeId((5,)),
        SensorFault(3, "jumped by +2223 counts", since_sync=1),
        SensorFault(3, STUCK, stuck=True),
        SensorFault(3, "stands still", stuck=True),
        *(DriveFault(1, code, emergency_text(code)) for code in TRIPS),
        UnidentifiableError(
            (UNIDENTIFIABLE,), stuck_joint=3, note="the sensor of joint 3 is stuck"
        ),
        UnidentifiableError((UNIDENTIFIABLE,), note="joint 4 does not move"),
        TooFewPosesError(poses=3, needed=5, parameters=14, equations_per_pose=3),
        FixtureError("the axes are parallel"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_error_text_is_approved(error, approve):
    approve(str(words(error)))


@pytest.mark.parametrize(
    ("happened", "remedy"),
    [
        ("sessions/one/journal.jsonl was deleted", "sarcal session list shows the others"),
        ("a_0 cannot be determined", "pip install the arm's package"),
    ],
)
def test_paths_and_names_keep_their_case(happened, remedy):
    text = words(SessionError(happened, remedy))
    assert (text.happened, text.remedy) == (happened, remedy)
    assert words(SessionError("the arm moved", "wait")).happened == "The arm moved"


def test_an_arm_whose_drives_are_off_is_not_said_to_hold():
    error = DriveFault(5, 0x8400, emergency_text(0x8400))
    error.drives_after = "All drives have been switched off again"
    assert "holds" not in str(words(error))


@pytest.mark.parametrize("kind", REMEDIES, ids=lambda kind: kind.__name__)
def test_remedy_of_every_error_is_approved(kind, approve):
    approve(REMEDIES[kind])
