"""Names of nodes, COB-IDs, object indices and codes of CiA 301 and CiA 402; 2000h to 2FFFh are this project's.

Type, access, range and default of the objects are in the EDS files of `hardware.eds`; a test compares the indices.

Positions are counts in sensor coordinates (the measured theta). 607Ch holds the calibration's theta_off in
the same counts: it is stored and read back, but never shifts 6064h.
"""

import struct
from enum import IntEnum, IntFlag
from typing import Final, Self

from hardware.arm import JointMode

# ---- nodes -------------------------------------------------------------------------------------
MAX_JOINTS: Final = 15
"""Joint j is node j; node 16 is the supervisor."""
SUPERVISOR_NODE: Final = 16
OPERATOR_NODE: Final = 127


def joint_node(joint: int) -> int:
    """Return the node number of a joint (1-based); `ValueError` if there is no such joint."""
    if not 1 <= joint <= MAX_JOINTS:
        raise ValueError(f"joint {joint} is not one of 1..{MAX_JOINTS}")
    return joint


# ---- COB-IDs (predefined connection set of CiA 301) --------------------------------------------
COB_NMT: Final = 0x000
COB_SYNC: Final = 0x080
COB_EMCY: Final = 0x080
COB_TPDO1: Final = 0x180
COB_RPDO1: Final = 0x200
COB_SDO_FROM_SERVER: Final = 0x580
COB_SDO_TO_SERVER: Final = 0x600
COB_HEARTBEAT: Final = 0x700
"""All COB-IDs but those of NMT and SYNC are bases, to which the node number is added."""
COB_NEXT_PDO: Final = 0x100
"""Difference between the identifiers of consecutive PDOs of the predefined connection set."""


def node_of(identifier: int, base: int) -> int:
    """Return the node of a frame whose identifier is `base` plus a node number; 0 for other frames."""
    node = identifier - base
    return node if 0 < node <= OPERATOR_NODE else 0


# ---- NMT and heartbeat -------------------------------------------------------------------------
class NmtState(IntEnum):
    """NMT state as in a heartbeat."""

    BOOT_UP = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


class NmtCommand(IntEnum):
    """NMT commands: first byte of the frame; the second is the node, 0 for all."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


HEARTBEAT_PERIOD_S: Final = 0.1
HEARTBEAT_TIMEOUT_S: Final = 0.5
MAX_OPERATOR_TIMEOUT_S: Final = 10.0
"""Longest time-out for the operator's heartbeat (1016h) with which this program enables a drive."""
ADVISED_OPERATOR_TIMEOUT_S: Final = 2.0
"""Advised limit of a drive's time-out for the operator's heartbeat; `sarcal arm-check` reports longer time-outs."""
CONTROL_PERIOD_S: Final = 0.01
"""Period of SYNC (60C2h)."""

# ---- PDOs --------------------------------------------------------------------------------------
TPDO_EVERY_SYNC: Final = 1
EMCY: Final = struct.Struct("<HB5s")
"""Layout of an emergency message: error code, error register 1001h, five bytes of the maker (unused here)."""

# ---- CiA 301 objects ---------------------------------------------------------------------------
DEVICE_TYPE: Final = 0x1000
ERROR_REGISTER: Final = 0x1001
ERROR_FIELD: Final = 0x1003
ERROR_HISTORY: Final = 8
"""Number of errors that 1003h can hold."""
SYNC_COB_ID: Final = 0x1005
DEVICE_NAME: Final = 0x1008
EMCY_COB_ID: Final = 0x1014
HEARTBEAT_CONSUMER: Final = 0x1016
HEARTBEAT_PRODUCER: Final = 0x1017
IDENTITY: Final = 0x1018
SDO_SERVER: Final = 0x1200
RPDO1_COMMUNICATION: Final = 0x1400
RPDO1_MAP: Final = 0x1600
TPDO1_COMMUNICATION: Final = 0x1800
TPDO1_MAP: Final = 0x1A00

# Sub-indices of 1018h.
IDENTITY_VENDOR: Final = 1
IDENTITY_PRODUCT: Final = 2
IDENTITY_REVISION: Final = 3
IDENTITY_SERIAL: Final = 4

# ---- CiA 402 objects ---------------------------------------------------------------------------
ABORT_OPTION: Final = 0x6007
"""Abort connection option: reaction to a lost heartbeat; 0 means no action."""
ERROR_CODE: Final = 0x603F
CONTROLWORD: Final = 0x6040
STATUSWORD: Final = 0x6041
QUICK_STOP_OPTION: Final = 0x605A
"""Reaction to quick stop; 6 means: slow down on the quick-stop ramp and stay in *quick stop active*."""
MODE: Final = 0x6060
MODE_DISPLAY: Final = 0x6061
POSITION_ACTUAL: Final = 0x6064
FOLLOWING_WINDOW: Final = 0x6065
VELOCITY_ACTUAL: Final = 0x606C
"""Actual speed, counts per second."""
TARGET_TORQUE: Final = 0x6071
MAX_TORQUE: Final = 0x6072
RATED_TORQUE: Final = 0x6076
"""Rated torque in units of 0.001 N m; 6071h, 6072h and 6077h are in per mille of the rated torque."""
TORQUE_ACTUAL: Final = 0x6077
TARGET_POSITION: Final = 0x607A
POSITION_OFFSET: Final = 0x60B0
TORQUE_OFFSET: Final = 0x60B2
HOME_OFFSET: Final = 0x607C
POSITION_LIMITS: Final = 0x607D
"""Range of positions, counts: sub 1 lowest, sub 2 highest position."""
MAX_VELOCITY: Final = 0x607F
"""Limit of commanded speeds, and speed at which the drive trips, counts per second."""
ENCODER_RESOLUTION: Final = 0x608F
"""Resolution of the encoder: sub 1 is the number of increments in sub 2 revolutions."""
CONTROL_PERIOD: Final = 0x60C2
"""Period of SYNC, s: sub 1 times ten to the power of sub 2."""
SUPPORTED_MODES: Final = 0x6502

# ---- manufacturer-specific objects, joints -----------------------------------------------------
SENSOR: Final = 0x2100
"""The joint's sensor: sub 1 kind (`SensorKind`), sub 2 full scale in millionths of a degree, sub 3 converter bits."""
SENSOR_KIND: Final = 1
SENSOR_FULL_SCALE: Final = 2
SENSOR_BITS: Final = 3

# ---- manufacturer-specific objects, supervisor -------------------------------------------------
DOCUMENT: Final = 0x2000
"""Parameter document (DOMAIN). Reading returns the document written last until that document is committed, dropped or
refused, and then the active document; if there is neither, reading aborts with 08000024h (no data)."""
DIGEST: Final = 0x2001
"""Digest of 2000h, computed by the supervisor: sub 1 SHA-256 (32 bytes), sub 2 length."""
DIGEST_SHA256: Final = 1
DIGEST_LENGTH: Final = 2
COMMAND: Final = 0x2002
SLOTS: Final = 0x2003
"""State of the parameter slots. Sub 1: active slot (`Slot`). Subs 2 and 3: state of slots A and B (`SlotState`). Sub 4:
1 while a staged document waits for *commit*, otherwise 0."""
SLOTS_ACTIVE: Final = 1
SLOTS_A: Final = 2
SLOTS_B: Final = 3
SLOTS_STAGED: Final = 4
REFUSAL: Final = 0x2004
"""Reason for the last refusal, as text; reading aborts with 08000024h (no data) if nothing was refused."""
TOKEN: Final = 0x2010
"""Node in control; 0 if none is. Writing a node number takes control if that node's heartbeat is heard and no other
node is in control; writing 0 releases control. Control lapses when the holder's heartbeat is lost."""
ARM: Final = 0x2020
"""The arm: sub 1 model, sub 2 serial number (both text), sub 3 number of joints."""
ARM_MODEL: Final = 1
ARM_SERIAL: Final = 2
ARM_JOINTS: Final = 3


class ParameterCommand(IntEnum):
    """Values of 2002h; all need the control token. A refusal aborts the SDO transfer; 2004h has the reason."""

    STAGE = 1
    """Check the document in 2000h against the schema, this arm and its limits."""
    COMMIT = 2
    """Write the staged document to the spare slot, make that slot active, set 607Ch of every drive."""
    ROLL_BACK = 3
    """Drop the written or staged document; if there is none, activate the other slot."""


class Slot(IntEnum):
    """Parameter slots, with the numbers that 2003h sub 1 gives them."""

    NONE = 0
    A = 1
    B = 2


class SlotState(IntEnum):
    """State of slot A or B: 2003h subs 2 and 3."""

    EMPTY = 0
    WHOLE = 1
    DAMAGED = 2


class SensorKind(IntEnum):
    """Kind of a joint's sensor, as coded in 2100h sub 1."""

    NONE = 0
    ENCODER = 1
    RVDT = 2


# ---- modes of operation ------------------------------------------------------------------------
CYCLIC_POSITION: Final = 8
CYCLIC_TORQUE: Final = 10
MODE_CODE: Final = {JointMode.POSITION: CYCLIC_POSITION, JointMode.FREE: CYCLIC_TORQUE}
"""Code in 6060h/6061h by joint mode."""
JOINT_MODE: Final = {code: mode for mode, code in MODE_CODE.items()}
"""Joint mode by code in 6060h/6061h; other codes are neither position nor free."""


# ---- errors ------------------------------------------------------------------------------------
class ErrorBit(IntFlag):
    """Bits of the error register 1001h."""

    GENERIC = 1 << 0
    COMMUNICATION = 1 << 4
    PROFILE = 1 << 5
    MANUFACTURER = 1 << 7


class EmergencyCode(IntEnum):
    """Error codes in use (CiA 301 and CiA 402), with their texts."""

    text: str

    def __new__(cls, code: int, text: str) -> Self:
        """Return the member with this code and text."""
        member = int.__new__(cls, code)
        member._value_, member.text = code, text
        return member

    NONE = 0x0000, "no error"
    EXTERNAL_STOP = 0x5441, "external stop, contact 1"
    EXTERNAL_STOP_SECOND = 0x5442, "external stop, contact 2"
    SENSOR = 0x7305, "angle sensor failed"
    HEARTBEAT_LOST = 0x8130, "operator's heartbeat lost"
    EXCESS_TORQUE = 0x8311, "excess torque"
    OVERSPEED = 0x8400, "overspeed"
    FOLLOWING = 0x8611, "following error"
    REFERENCE_LIMIT = 0x8612, "target refused: outside the limits"


STOP_CONTACTS: Final = (EmergencyCode.EXTERNAL_STOP, EmergencyCode.EXTERNAL_STOP_SECOND)
"""Emergency codes of a pressed external stop."""


_ERROR_CLASSES: Final = {
    0x10: "generic error",
    0x20: "current",
    0x21: "current, input side",
    0x22: "current inside the device",
    0x23: "current, output side",
    0x30: "voltage",
    0x31: "mains voltage",
    0x32: "voltage inside the device",
    0x33: "output voltage",
    0x40: "temperature",
    0x41: "ambient temperature",
    0x42: "device temperature",
    0x50: "device hardware",
    0x60: "device software",
    0x70: "additional module",
    0x80: "monitoring",
    0x81: "communication",
    0x82: "protocol error",
    0x90: "external error",
}
"""Classes of error codes (CiA 301) by the upper byte or, if that byte is not listed, by its upper half."""


def emergency_text(code: int) -> str:
    """Return the text of an EMCY error code, or the text of its class if the code is not in `EmergencyCode`."""
    upper = code >> 8
    known = _ERROR_CLASSES.get(upper) or _ERROR_CLASSES.get(upper & 0xF0, "error of the device")
    return next((each.text for each in EmergencyCode if each == code), known)


class Abort(IntEnum):
    """SDO abort codes (CiA 301) that this program acts on."""

    NO_OBJECT = 0x06020000
    NO_SUBINDEX = 0x06090011
    LOCAL_CONTROL = 0x08000021
    """The control token is not held."""
    NO_DATA = 0x08000024


# ---- identity ----------------------------------------------------------------------------------
DRIVE_DEVICE_TYPE: Final = 0x00020192
"""CiA 402 (192h), servo drive."""
DEVICE_TYPE_MASK: Final = 0x00FFFFFF
"""Bits 24 to 31 of 1000h are the maker's."""
JOINT_PRODUCT: Final = 0x0001
SUPERVISOR_PRODUCT: Final = 0x0002
