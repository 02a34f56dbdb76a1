"""Description of every fault of the virtual controller: failure, message to the operator, remedy.

`sarcal controller --fault help` prints `FAULTS`, and the fault campaign tests them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType


class ArmReaction(StrEnum):
    """What the arm does once a fault is reported; the fault campaign checks it."""

    STANDS = "does not move; all drives hold or are off when the session ends"
    LATE = "moves at most to a target that arrives up to 50 ms late; all drives hold or are off when the session ends"
    HOLDS = "all drives stop and hold by themselves"
    TRIPS = "that drive blocks its valve or holds, all others stop and hold"
    BLOCKS = "all valves are blocked"
    UNHEARD = (
        "moves to the last targets of its servos and stops there; until the loop runs again only the hardware stop "
        "reaches it"
    )
    STOPPED = (
        "is stopped by the program when uncommanded motion is detected: that drive is switched off, all others stop "
        "and hold; after another message it does not move, its drives holding, tripped or off"
    )


ALL_POSES = "every pose accepted before"


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultDescription:
    """One fault.

    Attributes
    ----------
    texts
        Parts of possible messages to the operator; ``{joint}`` is the joint at fault.
    goes_on
        Whether a session may also run to its end without any such message.
    arm
        Reaction of the arm when the fault is reported.
    kept
        What remains of the session.
    at_connect
        Whether the fault shows while the arm is being connected, so that it must be injected before that.
    """

    broken: str
    texts: tuple[str, ...] = ()
    goes_on: bool = False
    remedy: str
    arm: ArmReaction = ArmReaction.STANDS
    kept: str = ALL_POSES
    at_connect: bool = False

    def symptom(self) -> str:
        """Return what the operator sees, as text."""
        clauses = " or ".join(f'"... {part.format(joint="J")} ..."' for part in self.texts)
        if not self.goes_on:
            return f"the message {clauses}"
        return f"nothing, or the message {clauses}" if clauses else "nothing: the session continues"

    def does(self) -> str:
        """Return the reaction of the arm, as text."""
        if not self.goes_on:
            return str(self.arm)
        return f"goes on; once the fault is reported: {self.arm}" if self.texts else "goes on"


_GONE = ("no answer from node", "does not answer", "has gone silent", "has left operation")
_BAD_FRAMES = (*_GONE, "bus loses frames", "Hardly any SYNC is answered")
_CABLE = (
    "Cable, connectors, terminators and bitrate; then connect again: every accepted pose stays."
)
_RECONNECT = "Find out why, then connect again: the arm is compared with its poses first."
_COMMISSION = "Commission the drive as the message says, then connect again; nothing was enabled."
_DIVERGED = (
    "Press STOP unless the program has stopped the arm. Repair that drive, or end the program that commands it; then "
    "reset (R, or `sarcal reset`) and go on: the first pose is measured again before anything else."
)
_COUNT_LOSS = ("joint {joint} jumped", "joint {joint} has shifted by")
"""Messages on lost counts. The second appears when the first pose is repeated: in position mode the drive moves the
joint by the lost counts."""
_COUNT_LOSS_KEPT = (
    f"{ALL_POSES}; if a joint in position mode is reported when the first pose is repeated, none since then "
    "(for a degree: at the next pose, from the 11th on; for less: at the end, and the verdict refuses to mix them)"
)
_COUNT_LOSS_REMEDY = (
    "Retake the marked poses; if the first pose reads differently, start a new session. Check the encoder's coupling "
    "and its cable."
)
_SENSOR = "Retake the marked poses; check the encoder's coupling and its cable."

FAULTS: Mapping[str, FaultDescription] = MappingProxyType(
    {
        "frames-lost": FaultDescription(
            broken="1 % of all frames are lost",
            texts=_BAD_FRAMES,
            goes_on=True,
            remedy=_CABLE,
        ),
        "frames-lost-10": FaultDescription(
            broken="10 % of all frames are lost",
            texts=_BAD_FRAMES,
            goes_on=True,
            remedy=_CABLE,
        ),
        "frames-doubled": FaultDescription(
            broken="10 % of all frames come twice",
            texts=("two devices answer",),
            goes_on=True,
            remedy="A repeater or gateway echoes: remove it.",
        ),
        "frames-reordered": FaultDescription(
            broken="10 % of all frames change places with the next",
            texts=(
                *_BAD_FRAMES,
                "jumped by",
                "two devices answer",
                "does not come to rest",
            ),
            goes_on=True,
            remedy="A gateway with several queues: configure it to keep the order, or remove it.",
        ),
        "frames-late": FaultDescription(
            broken="5 % of all frames come 5 to 50 ms late",
            texts=(
                *(*_BAD_FRAMES, "jumped by", "two devices answer", "does not come to rest"),
                # A target that arrives after its successors is a step back, which is refused or trips the drive; a
                # controlword undoes their effect.
                *("target refused", "overspeed", "the drive is in"),
            ),
            goes_on=True,
            arm=ArmReaction.LATE,
            remedy="A busy gateway or network in between delays them: connect the arm's bus directly.",
        ),
        "frames-flipped": FaultDescription(
            broken="1 % of all frames have one bit of their data flipped",
            texts=(
                *_BAD_FRAMES,
                *("jumped by", "refused", "are not set up as", "no CiA 402", "tripped: "),
                *(
                    "has restarted",
                    "is not the one",
                    "range",
                    "does not come to rest",
                    "in control",
                ),
                *("the drive is in", "STOP is latched", "the supervisor reports"),
            ),
            goes_on=True,
            remedy="CAN detects such errors, so a gateway or a driver causes them: replace it.",
        ),
        "babbling": FaultDescription(
            broken="five foreign frames follow every frame",
            goes_on=True,
            remedy="`sarcal monitor` counts them by identifier; take that node off the bus.",
        ),
        "bus-flicker": FaultDescription(
            broken="the bus fails for 0.2 s",
            texts=_BAD_FRAMES,
            goes_on=True,
            remedy=_CABLE,
        ),
        "bus-off": FaultDescription(
            broken="the bus fails for 3 s (bus-off, or a plug pulled and put back)",
            texts=(*_BAD_FRAMES, "operator's heartbeat lost", "the drive is in"),
            # If the bus is back while the nodes are awaited: those that are heard get the command again.
            goes_on=True,
            remedy=f"{_CABLE} The drives hold until then; `sarcal reset` clears their 8130h.",
            arm=ArmReaction.HOLDS,
        ),
        "silent-node": FaultDescription(
            broken="a joint's cable is cut",
            texts=_GONE,
            remedy=_CABLE,
            arm=ArmReaction.HOLDS,
        ),
        "silent-supervisor": FaultDescription(
            broken="the supervisor's cable is cut",
            texts=_GONE,
            goes_on=True,
            remedy=_CABLE,
        ),
        "no-heartbeat": FaultDescription(
            broken="a joint sends no heartbeat",
            texts=_GONE,
            goes_on=True,
            remedy=_RECONNECT,
        ),
        "other-heartbeat": FaultDescription(
            broken="a joint sends a heartbeat only every 5 s",
            texts=("a heartbeat every 1 ..", *_GONE),
            goes_on=True,
            remedy=_COMMISSION,
            at_connect=True,
        ),
        "missed-answers": FaultDescription(
            broken="a joint misses ten SYNCs",
            goes_on=True,
            remedy="Nothing: incomplete samples are not used.",
        ),
        "double-answers": FaultDescription(
            broken="a joint answers every SYNC twice",
            texts=("two devices answer as node {joint}",),
            remedy="Two devices have the same number: give one of them another.",
        ),
        "wrong-node": FaultDescription(
            broken="a joint answers with the number of the next one",
            texts=(*_GONE, "two devices answer as node"),
            remedy="Give each drive its own number again.",
        ),
        "other-map": FaultDescription(
            broken="a joint's TPDO1 carries its speed where its position belongs",
            texts=(
                "are not set up as this program requires",
                # During a session: detected at the reading of a pose, unless the joint seems to jump before.
                *("the set-up of these nodes was changed", "jumped by", "counts from its target"),
            ),
            remedy=_COMMISSION,
            at_connect=True,
        ),
        "sdo-stall": FaultDescription(
            broken="a joint answers no object access (SDO)",
            texts=("Node {joint} does not answer when asked for",),
            goes_on=True,
            remedy=_RECONNECT,
        ),
        "sdo-stall-supervisor": FaultDescription(
            broken="the supervisor answers no object access (SDO)",
            texts=("Node 16 does not answer when asked for",),
            goes_on=True,
            remedy=_RECONNECT,
            kept=f"{ALL_POSES}; of an upload, the document that was active",
        ),
        "sdo-abort": FaultDescription(
            broken="a joint refuses every object access (08000000h)",
            texts=("node {joint} refused ",),
            goes_on=True,
            remedy=_RECONNECT,
        ),
        "restart-node": FaultDescription(
            broken="a joint's drive restarts, its counter at zero",
            # Near zero if the arm has sagged before the next connection.
            texts=(
                "has left operation",
                "has restarted",
                "outside its range",
                "at zero",
                "near zero",
            ),
            remedy="Find out why it lost its power; reference its counter, then connect again.",
            kept=f"{ALL_POSES}; not the zero of that drive's counter",
        ),
        "restart": FaultDescription(
            broken="the whole controller restarts",
            texts=(*_GONE, "heartbeat lost", "refused", "in control"),
            goes_on=True,
            remedy=_RECONNECT,
            arm=ArmReaction.BLOCKS,
        ),
        "hang": FaultDescription(
            broken="the control loop hangs",
            texts=_GONE,
            arm=ArmReaction.UNHEARD,
            remedy=_RECONNECT,
        ),
        "unwatched": FaultDescription(
            broken="a drive does not monitor the operator's heartbeat (1016h): it would go on without one",
            texts=("for the heartbeat of node",),
            goes_on=True,
            remedy=_COMMISSION,
            at_connect=True,
        ),
        "lost-counts-5": FaultDescription(
            broken="an encoder loses 5 counts",
            texts=("joint {joint} jumped",),
            goes_on=True,
            remedy=_SENSOR,
        ),
        "lost-counts-500": FaultDescription(
            broken="an encoder loses 500 counts",
            texts=_COUNT_LOSS,
            goes_on=True,
            remedy=_COUNT_LOSS_REMEDY,
            kept=_COUNT_LOSS_KEPT,
        ),
        "sensor-jump": FaultDescription(
            broken="a sensor, encoder or RVDT, reads 2 deg more from one SYNC to the next",
            # For a driven joint: its drive compensates, which is a jerk of all joints.
            texts=(*_COUNT_LOSS, "overspeed"),
            goes_on=True,
            remedy=_COUNT_LOSS_REMEDY,
            kept=_COUNT_LOSS_KEPT,
        ),
        "ripple": FaultDescription(
            broken="a sensor has noise of ten counts, as of an unsteady supply",
            texts=("does not come to rest",),
            goes_on=True,
            remedy="Supply and shield of that sensor; RVDT amplifier.",
        ),
        "frozen-sensor": FaultDescription(
            broken="a sensor's reading is frozen",
            texts=(
                "reads the same count as at pose",
                # For a driven joint: its drive, or this program, detects the deviation on the way.
                *("following error", "counts from its target"),
            ),
            remedy=_SENSOR,
        ),
        "broken-sensor": FaultDescription(
            broken="a drive detects that its sensor has failed (7305h)",
            texts=("angle sensor failed", "the drive is in"),
            remedy="Repair the sensor, reset (R, or `sarcal reset`), then go on.",
            arm=ArmReaction.TRIPS,
        ),
        "collision": FaultDescription(
            broken="a joint trips for excess torque (8311h)",
            texts=("excess torque", "the drive is in"),
            remedy="The arm holds. Remove the obstacle, reset (R, or `sarcal reset`), then go on.",
            arm=ArmReaction.TRIPS,
        ),
        "blocked-joint": FaultDescription(
            broken="a joint in free mode does not move",
            texts=(
                "excess torque",
                "the drive is in",
                "poses could be reached",
                "does not come to rest",
            ),
            goes_on=True,
            remedy="Check that joint's valve; reset (R, or `sarcal reset`), then go on.",
            arm=ArmReaction.TRIPS,
        ),
        "sagging-drive": FaultDescription(
            broken="a drive in position mode does not hold, and reports no fault",
            texts=(
                *("following error", "counts from its target", "excess torque"),
                *("poses could be reached", "does not come to rest", "the drive is in"),
                "after it was stopped",
            ),
            remedy=_DIVERGED,
            arm=ArmReaction.STOPPED,
        ),
        "slipped-fixture": FaultDescription(
            broken="the fixture slips by 1 mm on the table",
            goes_on=True,
            remedy="No single reading shows it; the verdict does, given enough poses before and after. Fasten it, and "
            "start a new session.",
        ),
        "bound-hinge": FaultDescription(
            broken="the hinge is blocked",
            texts=("excess torque", "following error", "the drive is in"),
            goes_on=True,
            remedy="Clean and grease the hinge; reset (R, or `sarcal reset`), then go on.",
            arm=ArmReaction.TRIPS,
        ),
        "stray": FaultDescription(
            broken="a drive moves 5 deg from its target, and reports no fault",
            texts=(
                *("counts from its target", "after it was stopped", "excess torque"),
                *("does not come to rest", "the drive is in"),
            ),
            remedy=_DIVERGED,
            arm=ArmReaction.STOPPED,
        ),
        "lost-enable": FaultDescription(
            broken="a drive loses its enable for a moment: it switches off, and sends no emergency",
            # A drive that drops out before it reports enabled gets the command again until it reports enabled.
            texts=("the drive is in",),
            goes_on=True,
            remedy="Find out who switched it off, and why: it is not enabled again automatically. Reset (R, or "
            "`sarcal reset`) when it is safe, then go on.",
        ),
        "deaf-drive": FaultDescription(
            broken="a drive in position mode does not move, and reports that it does not follow (6041h, bit 12)",
            texts=("(6041h, bit 12)", "following error", "counts from its target"),
            goes_on=True,
            remedy="Check that drive: interpolation, halt, internal limits. Reset (R, or `sarcal reset`), then go on.",
        ),
        "emcy-storm": FaultDescription(
            broken="a drive sends fifty emergencies on every SYNC",
            texts=("joint {joint} tripped: ", "Hardly any SYNC is answered"),
            remedy="`sarcal monitor` shows the errors; take that drive off the bus.",
        ),
        "refused-modes": FaultDescription(
            broken="a drive does not change its mode",
            texts=("joint {joint} was asked for",),
            goes_on=True,
            remedy="Check that drive's fault and its 6502h, reset it, set the modes again.",
        ),
        "external-stop": FaultDescription(
            broken="the external stop is pressed (5441h)",
            texts=("external stop", "the drive is in"),
            remedy="Release it when it is safe, reset (R, or `sarcal reset`), then go on.",
            arm=ArmReaction.BLOCKS,
        ),
    }
)
"""All faults by name, in the order bus, nodes, sensors, mechanics, people."""


OPERATOR_SIDE: Mapping[str, FaultDescription] = MappingProxyType(
    {
        # tests/system/test_fault_recovery.py, test_freeze_of_0_3_s_trips_no_drive_and_loses_no_pose
        "frozen for 0.3 s": FaultDescription(
            broken="the operator's program freezes for less than the drives' heartbeat time-out (0.5 s)",
            goes_on=True,
            remedy="Nothing.",
        ),
        # tests/system/test_fault_recovery.py, test_resume_succeeds_after_frozen_operator_trips_drives
        "frozen for longer": FaultDescription(
            broken="the operator's program freezes for longer than that",
            texts=("operator's heartbeat lost",),
            remedy="Go on as the last line says: `sarcal run --resume` resets and compares the arm first.",
            arm=ArmReaction.HOLDS,
        ),
        # tests/system/test_kills.py and tests/oracles/killing.py
        "killed": FaultDescription(
            broken="the operator's program, or its computer, dies",
            texts=("--resume",),
            remedy="Start it again with `--resume latest`: every accepted pose is on disk.",
            arm=ArmReaction.HOLDS,
        ),
        # tests/operator_app/session/test_journal.py
        "disk full": FaultDescription(
            broken="the journal cannot be written",
            texts=("cannot write",),
            remedy="Free disk space, then go on: a pose that was not written was not accepted.",
        ),
        # tests/system/test_fault_campaign.py, test_changes_of_the_wall_clock_lose_no_pose
        "clock set back": FaultDescription(
            broken="somebody sets the computer's clock",
            goes_on=True,
            remedy="Nothing: poses count in the order in which they were taken.",
        ),
        # tests/system/test_busy_bus.py, tests/benchmarks/busy_bus.py
        "busy computer": FaultDescription(
            broken="other programs take the processor",
            texts=("operator's heartbeat lost",),
            goes_on=True,
            remedy="End them, or give `sarcal` real-time priority.",
            arm=ArmReaction.HOLDS,
        ),
        # tests/contracts/arm/test_contract.py, two operators exclude each other;
        # tests/hardware/control/canopen_arm/test_watching.py
        "second operator": FaultDescription(
            broken="another program wants to command the arm",
            texts=("in control", "Another program commands this arm"),
            remedy="End one of the two.",
        ),
    }
)
