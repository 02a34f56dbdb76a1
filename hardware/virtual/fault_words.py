"""Every fault that can be made on purpose, in words: what is broken, what is said of it, what to do. No code.

`FAULTS` is the documentation of all of them: `sarcal controller --fault help` prints it,
and the fault campaign holds the program to it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultWords:
    """One thing that can go wrong.

    Attributes
    ----------
    broken
        What does not work.
    says
        Parts of the sentences of which the operator may be told one; ``{joint}`` is whose fault it is.
    goes_on
        Whether a session may also go on to its end without a word.
    remedy
        What to do.
    """

    broken: str
    says: tuple[str, ...] = ()
    goes_on: bool = False
    remedy: str

    def seen(self) -> str:
        """What an operator sees, in a sentence."""
        told = " or ".join(f'"... {part.format(joint="J")} ..."' for part in self.says)
        if not self.goes_on:
            return f"is told {told}"
        return f"goes on, or is told {told}" if told else "goes on"


_GONE = ("no answer from node", "does not answer", "has gone silent", "has left operation")
_BAD_FRAMES = (*_GONE, "Hardly any SYNC is answered")
_CABLE = (
    "Cable, connectors, terminators and bitrate; then connect again: every accepted pose stays."
)
_RECONNECT = "Find out why, then connect again: the arm is compared with its poses first."
_COMMISSION = "Commission the drive as the message says, then connect again; nothing was enabled."
_SENSOR = "Retake what is marked; look at the encoder's coupling and its cable."

FAULTS: Mapping[str, FaultWords] = MappingProxyType(
    {
        "frames-lost": FaultWords(
            broken="1 % of all frames are lost", says=_BAD_FRAMES, goes_on=True, remedy=_CABLE
        ),
        "frames-lost-10": FaultWords(
            broken="10 % of all frames are lost", says=_BAD_FRAMES, goes_on=True, remedy=_CABLE
        ),
        "frames-doubled": FaultWords(
            broken="10 % of all frames come twice",
            says=("two devices answer",),
            goes_on=True,
            remedy="A repeater or gateway echoes: take it out.",
        ),
        "frames-reordered": FaultWords(
            broken="10 % of all frames change places with the next",
            says=(*_BAD_FRAMES, "jumped by", "two devices answer", "does not come to rest"),
            goes_on=True,
            remedy="A gateway with several queues: have it keep the order, or take it out.",
        ),
        "frames-late": FaultWords(
            broken="5 % of all frames come 5 to 50 ms late",
            says=(
                *(*_BAD_FRAMES, "jumped by", "two devices answer", "does not come to rest"),
                # A target that comes after its successors is a step back.
                "target refused",
            ),
            goes_on=True,
            remedy="A busy gateway or a network in between: connect the arm's bus directly.",
        ),
        "frames-flipped": FaultWords(
            broken="1 % of all frames have one bit of their data flipped",
            says=(
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
            remedy="No CAN does this by itself, a gateway or a driver may: change it.",
        ),
        "babbling": FaultWords(
            broken="five frames of nobody's follow every frame",
            goes_on=True,
            remedy="`sarcal monitor` counts them by identifier; take that node off the bus.",
        ),
        "bus-flicker": FaultWords(
            broken="the bus is out for 0.2 s",
            says=_BAD_FRAMES,
            goes_on=True,
            remedy=_CABLE,
        ),
        "bus-off": FaultWords(
            broken="the bus is out for 3 s, and back (bus-off, a plug pulled and put in again)",
            says=(*_BAD_FRAMES, "operator's heartbeat lost", "the drive is in"),
            remedy=f"{_CABLE} The drives hold meanwhile; `sarcal reset` clears their 8130h.",
        ),
        "silent-node": FaultWords(broken="a joint's cable is cut", says=_GONE, remedy=_CABLE),
        "silent-supervisor": FaultWords(
            broken="the supervisor's cable is cut", says=_GONE, goes_on=True, remedy=_CABLE
        ),
        "no-heartbeat": FaultWords(
            broken="a joint sends no heartbeat", says=_GONE, goes_on=True, remedy=_RECONNECT
        ),
        "other-heartbeat": FaultWords(
            broken="a joint sends a heartbeat every 5 s only",
            says=("a heartbeat every 1 ..",),
            goes_on=True,
            remedy=_COMMISSION,
        ),
        "missed-answers": FaultWords(
            broken="a joint misses ten SYNCs",
            goes_on=True,
            remedy="Nothing: samples that are not whole do not count.",
        ),
        "double-answers": FaultWords(
            broken="a joint answers every SYNC twice",
            says=("two devices answer as node {joint}",),
            remedy="Two devices have one number: give one of them another.",
        ),
        "other-map": FaultWords(
            broken="a joint's TPDO1 carries its speed where its position belongs",
            says=("are not set up as this program drives them",),
            goes_on=True,
            remedy=_COMMISSION,
        ),
        "sdo-stall": FaultWords(
            broken="a joint answers no object access (SDO)",
            says=("Node {joint} does not answer when asked for",),
            goes_on=True,
            remedy=_RECONNECT,
        ),
        "sdo-stall-supervisor": FaultWords(
            broken="the supervisor answers no object access (SDO)",
            says=("Node 16 does not answer when asked for",),
            goes_on=True,
            remedy="Whatever was active before an upload stays active. " + _RECONNECT,
        ),
        "sdo-abort": FaultWords(
            broken="a joint refuses every object access (08000000h)",
            says=("node {joint} refused ",),
            goes_on=True,
            remedy=_RECONNECT,
        ),
        "restart-node": FaultWords(
            broken="a joint's drive restarts, its counter at zero",
            says=("has left operation", "has restarted", "reads 0.000 deg"),
            remedy="Find out why it lost its power; reference its counter, then connect again.",
        ),
        "restart": FaultWords(
            broken="the whole controller restarts",
            says=(*_GONE, "heartbeat lost", "refused", "in control"),
            goes_on=True,
            remedy=_RECONNECT,
        ),
        "hang": FaultWords(broken="the control loop hangs", says=_GONE, remedy=_RECONNECT),
        "unwatched": FaultWords(
            broken="a drive does not watch the operator's heartbeat (1016h): it would go on without one",
            says=("'s heartbeat watched, for",),
            goes_on=True,
            remedy=_COMMISSION,
        ),
        "lost-counts-5": FaultWords(
            broken="an encoder loses 5 counts",
            says=("joint {joint} jumped",),
            goes_on=True,
            remedy=_SENSOR,
        ),
        "lost-counts-500": FaultWords(
            broken="an encoder loses 500 counts",
            says=("joint {joint} jumped",),
            goes_on=True,
            remedy=_SENSOR,
        ),
        "frozen-sensor": FaultWords(
            broken="a sensor stands still",
            says=(
                "reads as it did at pose",
                "following error",
            ),
            remedy=_SENSOR,
        ),
        "broken-sensor": FaultWords(
            broken="a drive sees that its sensor has failed (7305h)",
            says=("angle sensor failed", "the drive is in"),
            remedy="Mend the sensor, reset (R, or `sarcal reset`), then go on.",
        ),
        "collision": FaultWords(
            broken="a joint trips for excess torque (8311h)",
            says=("excess torque", "the drive is in"),
            remedy="The arm holds. Free what it met, reset (R, or `sarcal reset`), then go on.",
        ),
        "stray": FaultWords(
            broken="a drive goes where it was not told to, 5 deg, and does not say so",
            says=(
                *("from where it was told to be", "excess torque"),
                *("does not come to rest", "the drive is in"),
            ),
            remedy="Take that drive out of service.",
        ),
        "emcy-storm": FaultWords(
            broken="a drive sends fifty emergencies on every SYNC",
            says=("joint {joint} tripped: ", "Hardly any SYNC is answered"),
            remedy="`sarcal monitor` shows what it complains of; take that drive off the bus.",
        ),
        "refused-modes": FaultWords(
            broken="a drive stays in the mode it is in",
            says=("joint {joint} was asked for",),
            goes_on=True,
            remedy="Look at that drive's fault and its 6502h, reset it, apply the modes again.",
        ),
        "external-stop": FaultWords(
            broken="the external stop is pressed (5441h)",
            says=("external stop", "the drive is in"),
            remedy="Release it when it is safe, reset (R, or `sarcal reset`), then go on.",
        ),
    }
)
"""In the order of bus, nodes, sensors, mechanics, people."""
