"""Description of every fault of the virtual controller: failure, message to the operator, remedy.

`sarcal controller --fault help` prints `FAULTS`, and the fault campaign tests them.
"""

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from enum import StrEnum


class ArmReaction(StrEnum):
    """What the arm does once a fault is reported; the fault campaign checks it."""

    STANDS = "does not move; all drives hold or are off when the session ends"
    LATE = "moves at most to a target that arrives up to 50 ms late; all drives hold or are off when the session ends"
    HOLDS = "all drives stop and hold by themselves"
    TRIPS = "that drive blocks its valve or holds, all others stop and hold"
    BLOCKS = "all valves are blocked"
    UNHEARD = (
        "moves to the last targets of its servos and stops there; until the loop runs again, only the hardware stop "
        "acts on the arm"
    )
    STOPPED = (
        "is stopped by the program when uncommanded motion is detected: that drive is switched off, all others stop "
        "and hold; after another message the arm does not move, and its drives hold, have tripped or are off"
    )


ALL_POSES = "every pose accepted before"


@dataclass(frozen=True, slots=True)
class FaultDescription:
    """One fault: what fails (`broken`), what the operator must do (`remedy`), and what messages and motion follow."""

    broken: str
    remedy: str
    _: KW_ONLY
    texts: tuple[str, ...] = ()
    """Parts of possible messages to the operator; ``{joint}`` is the joint at fault."""
    arm: ArmReaction = ArmReaction.STANDS
    kept: str = ALL_POSES
    """`arm`: reaction of the arm when the fault is reported; `kept`: what remains valid of the session."""
    at_connect: bool = False
    """Whether the fault shows while the arm is being connected; such a fault must be injected before connecting."""
    always_reported: bool = False
    """Whether every session with this fault shows a message with one of `texts`."""

    def symptom(self) -> str:
        """Return what the operator sees, as text."""
        clauses = " or ".join(f'"... {part.format(joint="J")} ..."' for part in self.texts)
        if self.always_reported:
            return f"the message {clauses}"
        return f"nothing, or the message {clauses}" if clauses else "nothing: the session continues"

    def does(self) -> str:
        """Return the reaction of the arm, as text."""
        if self.always_reported:
            return str(self.arm)
        return f"goes on; once the fault is reported: {self.arm}" if self.texts else "goes on"


_GONE = (
    "no answer from node",
    "does not answer",
    "sends no heartbeat",
    "after the NMT command",
    "has gone silent",
    "left operation",
)
_BAD_FRAMES = (*_GONE, "bus loses or delays frames", "Hardly any SYNC is answered")
_CABLE = (
    "Cable, connectors, terminators and bitrate; then connect again: every accepted pose stays."
)
_RECONNECT = "Find out why, then connect again: the arm is first compared with the captured poses."
_COMMISSION = "Commission the drive as the message says, then connect again; nothing was enabled."
_DIVERGED = (
    "Press STOP unless the program has stopped the arm. Repair that drive, or end the program that commands it; then "
    "reset (R, or `sarcal reset`) and go on: the first pose is measured again before anything else."
)
_COUNT_LOSS = ("joint {joint} jumped", "joint {joint} has shifted by")
"""Messages on lost counts. The second message appears when the first pose is repeated: in position mode the drive moves
the joint by the lost counts."""
_COUNT_LOSS_KEPT = (
    f"{ALL_POSES}; if a joint in position mode is reported when the first pose is repeated, none since then (a shift "
    "of 1 deg: at the next pose, from the 11th on; a smaller one: at the end, and the verdict refuses to mix the poses)"
)
_COUNT_LOSS_REMEDY = (
    "Retake the marked poses; if the first pose reads differently, start a new session. Check the encoder's coupling "
    "and its cable."
)
_SENSOR = "Retake the marked poses; check the encoder's coupling and its cable."

FAULTS: Mapping[str, FaultDescription] = {
    "frames-lost": FaultDescription("1 % of all frames are lost", _CABLE, texts=_BAD_FRAMES),
    "frames-lost-10": FaultDescription("10 % of all frames are lost", _CABLE, texts=_BAD_FRAMES),
    "frames-doubled": FaultDescription(
        "10 % of all frames come twice",
        "A repeater or gateway echoes: remove it.",
        texts=("two devices answer",),
    ),
    "frames-reordered": FaultDescription(
        "10 % of all frames change places with the next",
        "A gateway with several queues: configure it to keep the order, or remove it.",
        texts=(*_BAD_FRAMES, "jumped by", "two devices answer", "does not come to rest"),
    ),
    # A late target is a step back, which is refused or trips the drive; a late controlword undoes later ones.
    "frames-late": FaultDescription(
        "5 % of all frames come 5 to 50 ms late",
        "A busy gateway or network in between delays them: connect the arm's bus directly.",
        texts=(
            *_BAD_FRAMES,
            "jumped by",
            "two devices answer",
            "does not come to rest",
            "target refused",
            "overspeed",
            "drive is in",
        ),
        arm=ArmReaction.LATE,
    ),
    "frames-flipped": FaultDescription(
        "1 % of all frames have one bit of their data flipped",
        "CAN detects such errors, so a gateway or a driver causes them: replace it.",
        texts=(
            *_BAD_FRAMES,
            "jumped by",
            "refused",
            "are not set up as",
            "tripped: ",
            "reports an error: ",
            "restarted",
            "is not the one",
            "range",
            "does not come to rest",
            "in control",
            "drive is in",
            "STOP is latched",
            "the supervisor reports",
        ),
    ),
    "babbling": FaultDescription(
        "five foreign frames follow every frame",
        "`sarcal monitor` counts them by identifier; take that node off the bus.",
    ),
    "bus-flicker": FaultDescription("the bus fails for 0.2 s", _CABLE, texts=_BAD_FRAMES),
    # Not reported if the bus is back while the program waits for the nodes: it repeats the NMT command.
    "bus-off": FaultDescription(
        "the bus fails for 3 s (bus-off, or a plug pulled and put back)",
        f"{_CABLE} The drives hold until then; `sarcal reset` clears their 8130h.",
        texts=(*_BAD_FRAMES, "operator's heartbeat lost", "drive is in"),
        arm=ArmReaction.HOLDS,
    ),
    "silent-node": FaultDescription(
        "a joint's cable is cut", _CABLE, texts=_GONE, arm=ArmReaction.HOLDS, always_reported=True
    ),
    "silent-supervisor": FaultDescription("the supervisor's cable is cut", _CABLE, texts=_GONE),
    "no-heartbeat": FaultDescription("a joint sends no heartbeat", _RECONNECT, texts=_GONE),
    "other-heartbeat": FaultDescription(
        "a joint sends a heartbeat only every 5 s",
        _COMMISSION,
        texts=("a heartbeat every 1 ..", *_GONE),
        at_connect=True,
    ),
    "missed-answers": FaultDescription(
        "a joint misses ten SYNCs", "Nothing: incomplete samples are not used."
    ),
    "double-answers": FaultDescription(
        "a joint answers every SYNC twice",
        "Two devices have the same number: give one of them another.",
        texts=("two devices answer as node {joint}",),
        always_reported=True,
    ),
    "wrong-node": FaultDescription(
        "a joint answers with the number of the next one",
        "Give each drive its own number again.",
        texts=(*_GONE, "two devices answer as node"),
        always_reported=True,
    ),
    # During a session it is detected when a pose is read, unless the joint seems to jump before.
    "other-map": FaultDescription(
        "a joint's TPDO1 carries its speed where its position belongs",
        _COMMISSION,
        texts=(
            "are not set up as this program requires",
            "the set-up of these nodes was changed",
            "jumped by",
            "counts from its target",
        ),
        at_connect=True,
        always_reported=True,
    ),
    "sdo-stall": FaultDescription(
        "a joint answers no object access (SDO)",
        _RECONNECT,
        texts=("Node {joint} does not answer when asked for",),
    ),
    "sdo-stall-supervisor": FaultDescription(
        "the supervisor answers no object access (SDO)",
        _RECONNECT,
        texts=("Node 16 does not answer when asked for",),
        kept=f"{ALL_POSES}; of an upload, the document that was active",
    ),
    "sdo-abort": FaultDescription(
        "a joint refuses every object access (08000000h)",
        _RECONNECT,
        texts=("node {joint} refused ",),
    ),
    # The counter is near zero if the arm has sagged before the next connection.
    "restart-node": FaultDescription(
        "a joint's drive restarts, its counter at zero",
        "Find out why it lost its power; reference its counter, then connect again.",
        texts=("left operation", "restarted", "outside its range", "at zero", "near zero"),
        kept=f"{ALL_POSES}; not the zero of that drive's counter",
        always_reported=True,
    ),
    "restart": FaultDescription(
        "the whole controller restarts",
        _RECONNECT,
        texts=(*_GONE, "heartbeat lost", "refused", "in control"),
        arm=ArmReaction.BLOCKS,
    ),
    "hang": FaultDescription(
        "the control loop hangs",
        _RECONNECT,
        texts=_GONE,
        arm=ArmReaction.UNHEARD,
        always_reported=True,
    ),
    "unwatched": FaultDescription(
        "a drive does not monitor the operator's heartbeat (1016h): it would go on without one",
        _COMMISSION,
        texts=("for the heartbeat of node",),
        at_connect=True,
    ),
    "lost-counts-5": FaultDescription(
        "an encoder loses 5 counts", _SENSOR, texts=("joint {joint} jumped",)
    ),
    "lost-counts-500": FaultDescription(
        "an encoder loses 500 counts", _COUNT_LOSS_REMEDY, texts=_COUNT_LOSS, kept=_COUNT_LOSS_KEPT
    ),
    # The drive of a driven joint compensates the jump, which jerks all joints: overspeed.
    "sensor-jump": FaultDescription(
        "a sensor, encoder or RVDT, reads 2 deg more from one SYNC to the next",
        _COUNT_LOSS_REMEDY,
        texts=(*_COUNT_LOSS, "overspeed"),
        kept=_COUNT_LOSS_KEPT,
    ),
    "ripple": FaultDescription(
        "a sensor has noise of ten counts, as from an unsteady supply",
        "Supply and shield of that sensor; RVDT amplifier.",
        texts=("does not come to rest",),
    ),
    # The deviation of a driven joint is detected on the way, by its drive or by this program.
    "frozen-sensor": FaultDescription(
        "a sensor's reading is frozen",
        _SENSOR,
        texts=("reads the same count as at pose", "following error", "counts from its target"),
        always_reported=True,
    ),
    "broken-sensor": FaultDescription(
        "a drive detects that its sensor has failed (7305h)",
        "Repair the sensor, reset (R, or `sarcal reset`), then go on.",
        texts=("angle sensor failed", "drive is in"),
        arm=ArmReaction.TRIPS,
        always_reported=True,
    ),
    "collision": FaultDescription(
        "a joint trips for excess torque (8311h)",
        "The arm holds. Remove the obstacle, reset (R, or `sarcal reset`), then go on.",
        texts=("excess torque", "drive is in"),
        arm=ArmReaction.TRIPS,
        always_reported=True,
    ),
    "blocked-joint": FaultDescription(
        "a joint in free mode does not move",
        "Check that joint's valve; reset (R, or `sarcal reset`), then go on.",
        texts=("excess torque", "drive is in", "poses could be reached", "does not come to rest"),
        arm=ArmReaction.TRIPS,
    ),
    "sagging-drive": FaultDescription(
        "a drive in position mode does not hold, and reports no fault",
        _DIVERGED,
        texts=(
            "following error",
            "counts from its target",
            "excess torque",
            "poses could be reached",
            "does not come to rest",
            "drive is in",
            "after it was stopped",
        ),
        arm=ArmReaction.STOPPED,
        always_reported=True,
    ),
    "slipped-fixture": FaultDescription(
        "the fixture slips by 1 mm on the table",
        "No single reading shows it; the verdict does, given enough poses before and after. Fasten it, and "
        "start a new session.",
    ),
    "bound-hinge": FaultDescription(
        "the hinge is blocked",
        "Clean and grease the hinge; reset (R, or `sarcal reset`), then go on.",
        texts=("excess torque", "following error", "drive is in"),
        arm=ArmReaction.TRIPS,
    ),
    "stray": FaultDescription(
        "a drive moves 5 deg from its target, and reports no fault",
        _DIVERGED,
        texts=(
            "counts from its target",
            "after it was stopped",
            "excess torque",
            "does not come to rest",
            "drive is in",
        ),
        arm=ArmReaction.STOPPED,
        always_reported=True,
    ),
    # A drive that drops out before it reports enabled gets the command again until it reports enabled.
    "lost-enable": FaultDescription(
        "a drive loses its enable for a moment: it switches off, and sends no emergency",
        "Find out who switched it off, and why: it is not enabled again automatically. Reset (R, or "
        "`sarcal reset`) when it is safe, then go on.",
        texts=("drive is in",),
    ),
    "deaf-drive": FaultDescription(
        "a drive in position mode does not move, and reports that it does not follow (6041h, bit 12)",
        "Check that drive: interpolation, halt, internal limits. Reset (R, or `sarcal reset`), then go on.",
        texts=(
            "(6041h, bit 12)",
            "no longer follows its target",
            "following error",
            "counts from its target",
        ),
    ),
    "emcy-storm": FaultDescription(
        "a drive sends fifty emergencies on every SYNC",
        "`sarcal monitor` shows the errors; take that drive off the bus.",
        texts=("joint {joint} reports an error: ", "Hardly any SYNC is answered"),
        always_reported=True,
    ),
    "refused-modes": FaultDescription(
        "a drive does not change its mode",
        "Check that drive's fault and its 6502h, reset it, set the modes again.",
        texts=("joint {joint} was asked for",),
    ),
    "external-stop": FaultDescription(
        "the external stop is pressed (5441h)",
        "Release it when it is safe, reset (R, or `sarcal reset`), then go on.",
        texts=("external stop", "drive is in"),
        arm=ArmReaction.BLOCKS,
        always_reported=True,
    ),
}
"""All faults by name, in the order bus, nodes, sensors, mechanics, people."""


OPERATOR_SIDE: Mapping[str, FaultDescription] = {
    "frozen for 0.3 s": FaultDescription(
        "the operator's program freezes for less than the drives' heartbeat time-out (0.5 s)",
        "Nothing.",
    ),
    "frozen for longer": FaultDescription(
        "the operator's program freezes for longer than the drives' heartbeat time-out (0.5 s)",
        "Go on as the last line says: `sarcal run --resume` resets and compares the arm first.",
        texts=("operator's heartbeat lost",),
        arm=ArmReaction.HOLDS,
        always_reported=True,
    ),
    "killed": FaultDescription(
        "the operator's program, or its computer, dies",
        "Start it again with `--resume latest`: every accepted pose is on disk.",
        texts=("--resume",),
        arm=ArmReaction.HOLDS,
        always_reported=True,
    ),
    "disk full": FaultDescription(
        "the journal cannot be written",
        "Free disk space, then go on: a pose that was not written was not accepted.",
        texts=("cannot write",),
        always_reported=True,
    ),
    "clock set back": FaultDescription(
        "somebody sets the computer's clock",
        "Nothing: poses count in the order in which they were taken.",
    ),
    "busy computer": FaultDescription(
        "other programs take the processor",
        "End them, or give `sarcal` real-time priority.",
        texts=("operator's heartbeat lost",),
        arm=ArmReaction.HOLDS,
    ),
    "second operator": FaultDescription(
        "another program wants to command the arm",
        "End one of the two.",
        texts=("in control", "Another program commands this arm"),
        always_reported=True,
    ),
}
