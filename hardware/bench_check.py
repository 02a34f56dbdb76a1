"""An arm on the bench, tried in a safe order before it is first used; asks before anything moves.

Each stage needs the one before it: look (nothing is enabled), hold (drives on, nothing moves, STOP), move
(one joint at a time by a little, and STOP on the way), free (one joint at a time lets go), silence (the
operator's heartbeat ends, as when this program is killed). Knows an arm and its drives' words; no screen.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np

from hardware.arm import ArmSnapshot, DriveState, JointMode
from hardware.canopen_arm import CanopenArm
from hardware.drive_facts import DriveFacts
from hardware.errors import HardwareError, Stopped

HOLDS_AFTER_STOP: Final = 5
"""605Ah from here on: the drive stays in *quick stop active*; below, it lets the joint go."""
SAMPLES: Final = 100
STILL_RAD: Final = math.radians(0.1)
QUIET_RAD: Final = math.radians(0.5)
STOPS_WITHIN_S: Final = 0.5
LONGEST_GUARD_S: Final = 2.0
_POLL_S: Final = 0.005


class Stage(Enum):
    """What is tried, in this order."""

    LOOK = "look"
    HOLD = "hold"
    MOVE = "move"
    FREE = "free"
    SILENCE = "silence"


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One thing that was tried: `passed` is None where it could not be found out; `text` says why."""

    stage: Stage
    name: str
    passed: bool | None
    text: str
    joint: int | None = None


Ask = Callable[[str], bool]
"""Puts a question to whoever stands beside the arm; whether it is answered with yes."""


def check(
    arm: CanopenArm, ask: Ask, *, last: Stage, step_rad: float, speed_rad_per_s: float
) -> Iterator[Finding]:
    """Check an arm that is not connected yet, up to and with a stage; leaves it held and closed.

    The caller closes the arm whatever happens. A stage in which something failed ends the check.
    """
    facts: tuple[DriveFacts, ...] = ()

    def look() -> Iterator[Finding]:
        nonlocal facts
        identity = arm.connect()
        yield _found(Stage.LOOK, "connect", f"{identity.model}, serial {identity.serial_number}")
        facts = arm.drive_facts()
        yield from _told(facts)
        yield from _quiet(arm)

    stages: dict[Stage, Callable[[], Iterator[Finding]]] = {
        Stage.LOOK: look,
        Stage.HOLD: lambda: _hold(arm, ask),
        Stage.MOVE: lambda: _move(arm, ask, step_rad, speed_rad_per_s),
        Stage.FREE: lambda: _free(arm, ask),
        Stage.SILENCE: lambda: _silence(arm, ask, facts),
    }
    for stage, tried in stages.items():
        fine = True
        try:
            for finding in tried():
                fine = fine and finding.passed is not False
                yield finding
        except HardwareError as error:
            fine = False
            yield _found(stage, "no error", str(error), passed=False)
        if not fine or stage is last:
            return


def _told(facts: Sequence[DriveFacts]) -> Iterator[Finding]:
    """What drives say they would do."""
    for drive in facts:
        lacking, option = drive.lacking_modes, drive.quick_stop_option
        yield _found(
            Stage.LOOK,
            "modes",
            "6502h does not say which modes it has"
            if lacking is None
            else f"6502h lacks mode {', '.join(map(str, lacking))}"
            if lacking
            else "6502h has both modes",
            passed=None if lacking is None else not lacking,
            joint=drive.joint,
        )
        yield _found(
            Stage.LOOK,
            "quick stop",
            "605Ah does not say what it does after a quick stop"
            if option is None
            else f"605Ah = {option}: it {'holds' if option >= HOLDS_AFTER_STOP else 'lets go'} after a "
            "quick stop",
            passed=None if option is None else option >= HOLDS_AFTER_STOP,
            joint=drive.joint,
        )
        guard = drive.misses_operator_after_s
        yield _found(
            Stage.LOOK,
            "guard",
            "1016h: it does not watch for the operator's heartbeat, and goes on when this program dies"
            if guard is None
            else f"1016h: it misses the operator after {guard:.2f} s",
            passed=guard is not None and guard <= LONGEST_GUARD_S,
            joint=drive.joint,
        )


def _quiet(arm: CanopenArm) -> Iterator[Finding]:
    """Drives are off, every SYNC is answered, readings stand."""
    on = [j.joint for j in arm.snapshot().joints if j.drive is DriveState.OPERATION_ENABLED]
    yield _found(
        Stage.LOOK,
        "drives off",
        f"joint {', '.join(map(str, on))} is enabled" if on else "no drive is enabled",
        passed=not on,
    )
    reading = arm.capture(SAMPLES)
    for joint, sd in enumerate(reading.sd_rad.tolist(), 1):
        yield _found(
            Stage.LOOK,
            "quiet",
            f"its reading scatters by {_deg(sd)} over {SAMPLES} SYNCs",
            passed=sd <= QUIET_RAD,
            joint=joint,
        )


def _hold(arm: CanopenArm, ask: Ask) -> Iterator[Finding]:
    if not ask(
        "The drives will be enabled. Nothing should move, and then STOP is tried. Keep clear, with a hand "
        "on the emergency stop. Enable them?"
    ):
        yield _declined(Stage.HOLD)
        return
    before = arm.capture(SAMPLES).mean_rad
    arm.take_control()
    yield _found(Stage.HOLD, "enable", "all drives are enabled")
    yield from _still(Stage.HOLD, "holds", before, arm.capture(SAMPLES).mean_rad)
    begun = time.monotonic()
    arm.stop()
    seconds = _all_stopped(arm, begun)
    yield _found(
        Stage.HOLD,
        "STOP",
        f"a drive is still enabled {STOPS_WITHIN_S:g} s after STOP"
        if seconds is None
        else f"all drives have stopped after {1e3 * seconds:.0f} ms",
        passed=seconds is not None,
    )
    _take_up_again(arm)
    yield from _still(Stage.HOLD, "holds after STOP", before, arm.capture(SAMPLES).mean_rad)


def _move(arm: CanopenArm, ask: Ask, step_rad: float, speed_rad_per_s: float) -> Iterator[Finding]:
    for joint in range(1, len(arm.snapshot().joints) + 1):
        start = arm.capture(SAMPLES).mean_rad
        way = arm.room(joint, step_rad)
        if not ask(
            f"Joint {joint} will turn by {_deg(way, sign=True)} and back, at {_deg(speed_rad_per_s)}/s. "
            "Turn it?"
        ):
            yield _declined(Stage.MOVE, joint)
            continue
        target = float(start[joint - 1]) + way
        arm.move({joint: target}, speed_rad_per_s=speed_rad_per_s)
        there = arm.capture(SAMPLES).mean_rad
        went = float(there[joint - 1] - start[joint - 1])
        yield _found(
            Stage.MOVE,
            "moves",
            f"told to turn by {_deg(way, sign=True)}, it reads {_deg(went, sign=True)}",
            passed=abs(went - way) <= 0.5 * abs(way),
            joint=joint,
        )
        others = np.delete(np.abs(there - start), joint - 1)
        yield _found(
            Stage.MOVE,
            "alone",
            f"no other joint turned by more than {_deg(float(others.max(initial=0.0)))}",
            passed=float(others.max(initial=0.0)) <= max(0.5 * abs(way), STILL_RAD),
            joint=joint,
        )
        yield _found(
            Stage.MOVE,
            "direction",
            "it turned in the sense of the arm file"
            if (
                right := ask(
                    f"Did joint {joint}, and no other, turn in the {'positive' if way > 0 else 'negative'} "
                    "sense of the arm file?"
                )
            )
            else "it turned otherwise: look at direction, and at the order of joints, in the bus profile",
            passed=right,
            joint=joint,
        )
        yield from _stop_on_the_way(arm, joint, float(start[joint - 1]), speed_rad_per_s)


def _stop_on_the_way(
    arm: CanopenArm, joint: int, home_rad: float, speed_rad_per_s: float
) -> Iterator[Finding]:
    """Back to where it was, with a STOP half-way."""
    here = float(arm.capture(1).mean_rad[joint - 1])
    half = 0.5 * abs(home_rad - here)
    at: list[float] = []

    def watch(snapshot: ArmSnapshot) -> None:
        gone = float(snapshot.positions_rad[joint - 1]) - here
        if not at and abs(gone) >= half:
            at.append(gone)
            arm.stop()

    try:
        arm.move({joint: home_rad}, speed_rad_per_s=speed_rad_per_s, watch=watch)
        stopped = False
    except Stopped:
        stopped = True
    _all_stopped(arm, time.monotonic())
    _take_up_again(arm)
    gone = float(arm.capture(SAMPLES).mean_rad[joint - 1]) - here
    ran_on = abs(gone - at[0]) if at else math.inf
    yield _found(
        Stage.MOVE,
        "STOP on the way",
        f"it came to rest {_deg(ran_on)} after STOP" if stopped else "it was not stopped",
        passed=stopped and ran_on <= max(half, STILL_RAD),
        joint=joint,
    )
    arm.move({joint: home_rad}, speed_rad_per_s=speed_rad_per_s)


def _free(arm: CanopenArm, ask: Ask) -> Iterator[Finding]:
    joints = len(arm.snapshot().joints)
    for joint in range(1, joints + 1):
        if not ask(
            f"Joint {joint} will be let free: it gives way to a hand, and to its weight. Support the arm. "
            "Free it?"
        ):
            yield _declined(Stage.FREE, joint)
            continue
        modes = [JointMode.POSITION] * joints
        modes[joint - 1] = JointMode.FREE
        arm.set_modes(modes)
        yield _found(Stage.FREE, "frees", "6061h says that it is free", joint=joint)
        arm.hold()
        yield _found(Stage.FREE, "takes up", "6061h says that it holds again", joint=joint)


def _silence(arm: CanopenArm, ask: Ask, facts: Sequence[DriveFacts]) -> Iterator[Finding]:
    guards = [drive.misses_operator_after_s for drive in facts]
    longest = max((guard for guard in guards if guard is not None), default=0.0)
    if longest == 0.0 or None in guards:
        yield _found(
            Stage.SILENCE, "guard", "not every drive watches for the operator", passed=None
        )
        return
    if not ask(
        f"This program will fall silent for {2 * longest:.1f} s while the drives are enabled, as if it were "
        "killed. They should stop and hold by themselves. Keep clear. Fall silent?"
    ):
        yield _declined(Stage.SILENCE)
        return
    before = arm.capture(SAMPLES).mean_rad
    arm.fall_silent()
    threading.Event().wait(2 * longest)
    arm.connect()
    on = [j.joint for j in arm.snapshot().joints if j.drive is DriveState.OPERATION_ENABLED]
    yield _found(
        Stage.SILENCE,
        "stops alone",
        f"joint {', '.join(map(str, on))} was still enabled"
        if on
        else "no drive was enabled any more",
        passed=not on,
    )
    arm.reset_stop()  # they have tripped for it, and a tripped arm is not read
    yield from _still(Stage.SILENCE, "held alone", before, arm.capture(SAMPLES).mean_rad)


def _still(stage: Stage, name: str, before: np.ndarray, after: np.ndarray) -> Iterator[Finding]:
    gone = np.abs(after - before)
    joint = int(np.argmax(gone)) + 1
    most = float(gone.max())
    yield _found(
        stage,
        name,
        f"no joint turned by more than {_deg(most)} (joint {joint})",
        passed=most <= STILL_RAD,
    )


def _all_stopped(arm: CanopenArm, begun_s: float) -> float | None:
    """Seconds until no drive is enabled; None if that takes too long."""
    while (seconds := time.monotonic() - begun_s) < STOPS_WITHIN_S:
        joints = arm.snapshot().joints
        if all(joint.drive is not DriveState.OPERATION_ENABLED for joint in joints):
            return seconds
        threading.Event().wait(_POLL_S)
    return None


def _take_up_again(arm: CanopenArm) -> None:
    arm.reset_stop()
    arm.take_control()


def _declined(stage: Stage, joint: int | None = None) -> Finding:
    return _found(stage, "agreed", "not tried: nobody agreed to it", passed=None, joint=joint)


def _found(
    stage: Stage, name: str, text: str, *, passed: bool | None = True, joint: int | None = None
) -> Finding:
    return Finding(stage=stage, name=name, passed=passed, text=text, joint=joint)


def _deg(angle_rad: float, *, sign: bool = False) -> str:
    return f"{math.degrees(angle_rad):{'+' if sign else ''}.3f} deg"
