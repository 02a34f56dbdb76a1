"""Errors of arm, solver and disk as what happened and what to do now.

The screen and plain mode show the same sentences.
"""

from __future__ import annotations

from collections.abc import Mapping

from fixtures.base import FixtureError
from hardware.arm import ArmIdentity, DriveState
from hardware.canopen.objects import STOP_CONTACTS, EmergencyCode
from hardware.errors import (
    BusError,
    CommandRefused,
    ControlDenied,
    DriveDiverged,
    DriveDropout,
    DriveFault,
    DuplicateNodeId,
    HardwareError,
    HostLatencyExceeded,
    MappingChanged,
    MappingMismatch,
    ModeNotReached,
    NodeMissing,
    NodeRestarted,
    OtherMaster,
    PdoSetupFailed,
    SensorFault,
    Stopped,
    UploadRefused,
    UploadUnknown,
    WrongArm,
)
from operator_app.config.errors import ConfigError, WriteError
from operator_app.config.procedure import Procedure
from operator_app.errors import SessionError
from operator_app.units.figure import REACH
from solver.errors import SolverError, TooFewPosesError, UnidentifiableError

EXPECTED = (SessionError, HardwareError, SolverError, FixtureError, ConfigError, WriteError)
"""Errors that an operator, an arm or a disk can cause. Any other one is a defect of this program."""


def words(error: BaseException) -> SessionError:
    """Return what happened and what to do now."""
    if isinstance(error, SessionError):
        return SessionError(_capital(error.happened), _capital(error.remedy))
    return SessionError(_capital(str(error).removesuffix(".")), _remedy(error))


REACHES_NOTHING = (
    "from where the arm stands by its readings, no pose of the plan can be reached: a joint's counter, its range "
    "or this fixture's file is not what it should be. Look at the joints' positions (step 3)"
)


def stopped_words(why: str) -> str:
    """Return why the arm stopped where nobody pressed STOP, and what to do now."""
    return f"{_capital(why)}. {_REMEDIES[DriveDiverged]}"


def _remedy(error: BaseException) -> str:
    if isinstance(error, UnidentifiableError) and error.stuck_joint:
        return (
            "Mend that sensor, or calibrate without it (J, or --unsensed); more poses do not help"
        )
    if isinstance(error, SensorFault) and error.stuck:
        return "The other poses stay"
    if isinstance(error, DriveFault) and error.code in _TRIPS:
        return _TRIPS[error.code]
    found = next((kind for kind in type(error).__mro__ if kind in _REMEDIES), None)
    return "Nothing was changed" if found is None else _REMEDIES[found]


_REMEDIES: Mapping[type, str] = {
    BusError: "The drives hold by themselves when the heartbeat is gone. Check cable and interface, "
    "then connect again",
    HostLatencyExceeded: "The drives hold by themselves when the heartbeat is gone. End other programs on this "
    "computer, then connect again",
    NodeMissing: "Check that these nodes are powered and on the bus, then connect again",
    WrongArm: "Connect the arm that the arm file describes, or name its own arm file",
    MappingMismatch: "Nothing was enabled and nothing moves",
    MappingChanged: "This pose was not captured; each before it was compared and stays",
    PdoSetupFailed: "Nothing was enabled and nothing moves",
    ControlDenied: "Ask the other operator to give up control, then connect again",
    DuplicateNodeId: "Until then nothing moves and nothing is captured",
    OtherMaster: "Until then nothing moves and nothing is captured",
    NodeRestarted: "Until then nothing moves and nothing is captured",
    SensorFault: "Look at that joint's coupling and cable, then connect again: the first pose is read again before "
    "any other counts",
    ModeNotReached: "Look at that drive's fault, reset it (R) and apply the modes again",
    DriveDiverged: "Keep clear until you know why: the drive has failed, or somebody else leads it. Then reset "
    "(R, or `sarcal reset`), and go on from the modes",
    DriveDropout: "Ask who switched it off, and why; when it is safe, reset (R) and apply the modes again",
    DriveFault: "The arm holds. Find out what it met, reset (R) and apply the modes again",
    Stopped: "Reset STOP (R) when it is safe; nothing moves by itself",
    CommandRefused: "Nothing was sent to the drives",
    UploadUnknown: "Upload again (step 7, or `sarcal export SESSION --upload`); until then do not rely on what the "
    "controller has",
    UploadRefused: "The parameters that were active before stay active",
    UnidentifiableError: "Take poses that differ more, or free a joint that stands still",
    TooFewPosesError: "Capture more poses (step 4)",
    FixtureError: "Remount the fixture as said, then check it again (step 2)",
    WriteError: "Free space or choose another folder; the journal is whole",
}
"""By the class of the error, or the nearest one above it."""

_TRIPS: Mapping[int, str] = {
    **dict.fromkeys(
        STOP_CONTACTS,
        "Release the external stop when it is safe, then reset (R) and apply the modes again",
    ),
    EmergencyCode.HEARTBEAT_LOST: "The arm holds. This computer paused, or its bus did: reset (R) and apply the "
    "modes again",
    EmergencyCode.SENSOR: "The arm holds. Mend that sensor or its cable, then reset (R) and apply the modes again",
}
"""Remedies of trips without a collision, by emergency code."""


def drive_words(state: DriveState) -> str:
    """Return a drive's state in one of four words for an operator beside the arm."""
    match state:
        case DriveState.OPERATION_ENABLED:
            return "enabled"
        case DriveState.QUICK_STOP_ACTIVE:
            return "stopped"
        case DriveState.FAULT | DriveState.FAULT_REACTION_ACTIVE:
            return "in fault"
        case _:
            return "off"


def summary(procedure: Procedure) -> str:
    """Return a procedure in one line: fixture, drive joints, poses."""
    capture, joints = procedure.capture, procedure.position_joints
    drives = "drive joints by rank"
    if joints is not None:
        drives = f"J{' J'.join(map(str, joints))} drive{'s' if len(joints) == 1 else ''}"
    poses = f"{capture.poses} poses as they come"
    if capture.strategy == "planned":
        poses = f"{capture.poses} planned poses after a short exploration"
    return f"{procedure.name}: {procedure.fixture.name}, {drives}, {poses}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def unwatching_words(identity: ArmIdentity) -> str:
    """Name the drives without a heartbeat timeout (1016h); "" where all have one."""
    joints = identity.unwatching
    if not joints:
        return ""
    which = f"{'Joints' if len(joints) > 1 else 'Joint'} {', '.join(map(str, joints))}"
    return (
        f"{which}: without 1016h nothing says that a drive notices when this program is gone; it may stay as it "
        "is then, driven or free. Keep a hand on the hardware stop. What it does shows: sarcal arm-check"
    )


def configured_words(identity: ArmIdentity) -> str:
    """Say which objects of the drives were set as the bus profile asks; "" for none."""
    zeroed = identity.zeroed
    pdos = tuple(words for words in identity.configured if words not in zeroed)
    parts = [
        f"{len(changed)} {what}{'s' if len(changed) > 1 else ''} {how}: {changed[0]}"
        f"{'; and so on' if len(changed) > 1 else ''}. "
        for changed, what, how in (
            (
                pdos,
                "PDO",
                "of the drives set up as the bus profile asks, until the next connection or a loss of power",
            ),
            (zeroed, "torque or offset", "in the drives set to 0, and not set back"),
        )
        if changed
    ]
    return f"{''.join(parts)}The session's journal has them all" if parts else ""


def by_hand_words(targets_rad: Mapping[int, float]) -> str:
    """Ask a person to move the joints of an arm without drives by hand."""
    ways = " and ".join(f"J{j} to {REACH(q).with_unit}" for j, q in sorted(targets_rad.items()))
    return f"By hand: take {ways}, then let it stand"
