"""Messages for errors of arm, solver and disk, on the screen and in plain mode: what happened, and the remedy."""

from collections.abc import Mapping, Sequence

from fixtures.errors import FixtureError
from hardware import errors
from hardware.arm import ArmIdentity, DriveState, HostLatency
from hardware.canopen.cia402 import FAULT_STATES
from hardware.canopen.objects import STOP_CONTACTS, EmergencyCode
from operator_app.config.errors import ConfigError, WriteError
from operator_app.config.procedure import Procedure
from operator_app.errors import COMMAND_WORDS, SessionError
from operator_app.units import REACH, joints_named, plural
from solver.errors import SolverError, TooFewPosesError, UnidentifiableError

EXPECTED = (SessionError, errors.HardwareError, SolverError, FixtureError, ConfigError, WriteError)
"""Errors that an operator, an arm or a disk can cause. Any other error is a defect of this program."""


def words(error: BaseException) -> SessionError:
    """Return an error as a `SessionError`, which states for the operator what happened, and the remedy."""
    if isinstance(error, SessionError):
        return SessionError(_capital(error.happened), _capital(error.remedy))
    return SessionError(_capital(str(error).removesuffix(".")), _remedy(error))


REACHES_NOTHING = (
    "no pose of the plan can be reached from the arm's present readings: a joint's counter, its range or this "
    "fixture's file is wrong. Check the joints' positions (step 3)"
)


def stopped_words(reason: str) -> str:
    """Return why the arm stopped by itself, and the remedy."""
    return f"{_capital(reason)}. {REMEDIES[errors.DriveDiverged]}"


def unstopped_words(joints: Sequence[int]) -> str:
    """Return the clause that names joints whose drives have not obeyed STOP."""
    return f"{joints_named(joints)} {'has' if len(joints) == 1 else 'have'} NOT stopped"


def _remedy(error: BaseException) -> str:
    if isinstance(error, UnidentifiableError) and error.stuck_joint:
        return (
            "Repair that sensor, or calibrate without it (j, or --unsensed); more poses do not help"
        )
    if isinstance(error, errors.SensorFault) and error.stuck:
        return "The other poses are kept"
    if isinstance(error, errors.DriveFault) and (
        error.code in _TRIPS or type(error) is errors.DriveFault
    ):
        off = error.drives_after or error.code in STOP_CONTACTS
        remedy = _TRIPS.get(error.code, REMEDIES[errors.DriveFault])
        return remedy if off else f"The arm holds. {remedy}"
    matching = next((kind for kind in type(error).__mro__ if kind in REMEDIES), None)
    return "Nothing was changed" if matching is None else REMEDIES[matching]


REMEDIES: Mapping[type, str] = {
    errors.BusError: "Check power, cable and interface, then connect again. Drives that have power and monitor the "
    "heartbeat (1016h, 6007h) hold by themselves",
    errors.EndlessAnswer: "Then connect again; if it happens again, have the node repaired by its maker",
    errors.HostLatencyExceeded: "Close other programs on this computer, then connect again. Drives that monitor the "
    "heartbeat (1016h, 6007h) hold by themselves",
    errors.NodeMissing: "Then connect again",
    errors.NodeNotStarted: "Then connect again",
    errors.WrongArm: "Connect the arm that the arm file describes, or use the arm file of the connected arm",
    errors.MappingMismatch: "Nothing was enabled and nothing moves",
    errors.MappingChanged: "This pose was not captured; the earlier poses passed this check and are kept",
    errors.PdoSetupFailed: "Nothing was enabled and nothing moves",
    errors.SdoRefused: "See the manual of that node for what this object is and when it is refused. Set the node up "
    "with its maker's tool, then connect again",
    errors.ControlDenied: "Ask the other operator to give up control, then connect again",
    errors.DuplicateNodeId: "Until then this program moves nothing and captures nothing",
    errors.OtherMaster: "Until then this program moves nothing and captures nothing; the other program may still "
    "move the arm",
    errors.NodeRestarted: "Until then this program moves nothing and captures nothing",
    errors.SensorFault: "Check that joint's coupling and cable, then connect again: the first pose is measured again "
    "before any other is used",
    errors.ModeNotReached: "Read that drive's fault; if it is in fault, reset it (R); then apply the modes again",
    errors.DriveDiverged: "Keep clear until the cause is known: the drive has failed, or another controller commands "
    "it. Then reset (R, or `sarcal reset`) and apply the modes again",
    errors.DriveDropout: "Find out who switched the drive off, and why; when it is safe, reset (R) and apply the "
    "modes again",
    errors.DriveFault: "Find the cause of this fault, then reset (R) and apply the modes again",
    errors.Stopped: "Reset STOP (R) when it is safe; nothing moves by itself",
    errors.CommandRefused: "Nothing was sent to the drives",
    errors.DriveNotReady: "Find out what keeps that drive in this state (its display or its maker's tool), then "
    "reset (R) and apply the modes again",
    errors.TargetRefused: "The arm holds; that drive keeps its previous target. Compare its limits (607Dh, 607Fh) "
    "with the arm file, then reset (R) and apply the modes again",
    errors.UploadUnknown: "Upload again (step 7, or `sarcal export SESSION --upload`); until then do not rely on "
    "the parameters in the controller",
    errors.UploadRefused: "Remove the cause, then upload again (step 7, or `sarcal export SESSION --upload`)",
    UnidentifiableError: "Take poses that differ more from each other, or set joints that did not move to free mode",
    TooFewPosesError: "Capture more poses (step 4)",
    FixtureError: "Remount the fixture as described, then check it again (step 2)",
    WriteError: "Free some disk space or choose another folder; the journal is complete",
}
"""Remedies by class of error; an error whose class is not listed has the remedy of its nearest base class."""

_TRIP_CAUSES: Mapping[int, str] = {
    **dict.fromkeys(STOP_CONTACTS, "Release the external stop when it is safe"),
    EmergencyCode.EXCESS_TORQUE: "Find what the joint hit or what overloads it",
    EmergencyCode.SENSOR: "Repair that sensor or its cable",
}
"""How to remove the cause of a trip, by the emergency code that names the cause."""

_TRIPS: Mapping[int, str] = {
    EmergencyCode.HEARTBEAT_LOST: "This computer or its bus was blocked: reset (R) and apply the modes again",
    **{
        code: f"{remove}, then reset (R) and apply the modes again"
        for code, remove in _TRIP_CAUSES.items()
    },
}
"""Remedies of trips, with the keys of the terminal app, by emergency code."""


def trip_cause_remedy(code: int) -> str:
    """Return how to remove the cause of a drive's trip (`code`: emergency code), as required before its reset."""
    return _TRIP_CAUSES.get(code, "Find the cause of this fault")


def drive_words(state: DriveState) -> str:
    """Return a drive's state as one of four short terms for an operator beside the arm."""
    if state in FAULT_STATES:
        return "in fault"
    terms = {DriveState.OPERATION_ENABLED: "enabled", DriveState.QUICK_STOP_ACTIVE: "stopped"}
    return terms.get(state, "off")


def summary(procedure: Procedure) -> str:
    """Return a procedure in one line: fixture, drive joints, poses."""
    capture, joints = procedure.capture, procedure.position_joints
    drives = "drive joints by rank"
    if joints is not None:
        drives = f"J{' J'.join(map(str, joints))} drive{'s' if len(joints) == 1 else ''}"
    planned = capture.strategy == "planned"
    poses = "planned poses after a short exploration" if planned else "explored poses"
    return f"{procedure.name}: {procedure.fixture.name}, {drives}, {capture.poses} {poses}"


def _capital(text: str) -> str:
    first, _, _ = text.partition(" ")
    spelled = "/" in first or "_" in first or text.startswith(COMMAND_WORDS)
    return text if spelled else text[:1].upper() + text[1:]


def unwatching_words(identity: ArmIdentity) -> str:
    """Return the warning that names drives that do not act on a lost heartbeat (1016h, 6007h); "" if all do."""
    joints = identity.unwatching
    if not joints:
        return ""
    which, drives, they = "Joint", "drive has", "it"
    if len(joints) > 1:
        which, drives, they = "Joints", "drives have", "they"
    return (
        f"{which} {', '.join(map(str, joints))}: the {drives} no heartbeat time-out (1016h), or no reaction to it "
        f"(6007h = 0). When this program ends, {they} may stay powered, or leave a joint free to move. Keep a "
        "hand on the hardware stop; sarcal arm-check shows what happens"
    )


def connected_words(identity: ArmIdentity) -> str:
    """Return model, serial number and nodes of a connected arm."""
    kind = f"{'simulated ' if identity.simulated else ''}{identity.speaks} node"
    nodes = plural(len(identity.nodes), kind)
    return f"Connected to {identity.model}, serial {identity.serial_number}: {nodes}"


def configured_words(identity: ArmIdentity) -> str:
    """Return the text that states how many drive objects were changed for the bus profile; "" if none were changed."""
    zeroed = identity.zeroed
    pdos = tuple(text for text in identity.configured if text not in zeroed)
    until = "configured as the bus profile requires (until the next connection or power cycle)"
    kept, parts = "set to 0 and will not be restored", []
    for changed, what, how in ((pdos, "PDO", until), (zeroed, "torque or offset", kept)):
        if changed:
            rest = len(changed) - 1
            were, more = ("were", f"; and {rest} more") if rest else ("was", "")
            parts.append(f"{plural(len(changed), what)} {were} {how}: {changed[0]}{more}.")
    if not parts:
        return ""
    return f"Changed in the drives: {' '.join(parts)} The session's journal lists all changes"


def lateness_words(late: HostLatency, times: int) -> str:
    """Return the message about the last `times` delays that this computer, not the arm, caused (host latency)."""
    how = f"by {late.last_s:.1f} s"
    if times > 1:
        how = f"{times} times, the last time {how}"
    return (
        f"this computer was late {how}: it was too busy, or sarcal was suspended (Ctrl+Z), and no new targets were "
        "sent. The session goes on, unless drives missed the heartbeat (8130h). End other programs on this computer, "
        "and do not suspend sarcal"
    )


def by_hand_words(targets_rad: Mapping[int, float]) -> str:
    """Return the instruction to move joints of an arm without drives by hand, each to its target, rad."""
    ways = " and ".join(f"J{j} to {REACH(q).with_unit}" for j, q in sorted(targets_rad.items()))
    return f"By hand: move {ways}, then leave the arm at rest"
