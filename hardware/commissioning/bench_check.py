"""Acceptance check of an arm on the bench, in a safe order; the person beside the arm is asked before any motion.

The requirements are in `clauses` and `checks`. A failure in the read-only stage `look` ends the check after that stage;
a failure in a later stage ends the check at once.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from enum import Enum
from functools import partial
from typing import Final

from hardware.arm import ArmIdentity, ArmInterface, JointMode
from hardware.arm_description import ArmDescription
from hardware.commissioning import checks, clauses
from hardware.commissioning.clauses import Ask, Bounds, Clause
from hardware.control.canopen_arm import CanopenArm
from hardware.errors import HardwareError


class Stage(Enum):
    """Stages of the bench check, in order; each stage requires that all earlier stages have passed."""

    LOOK = "look"
    """No drive is enabled."""
    HOLD = "hold"
    """Drives are enabled without motion; commands are sent that must be refused; STOP is tested."""
    MOVE = "move"
    """One joint at a time moves to a target and back; it is halted, interrupted and stopped on the way."""
    FREE = "free"
    """One joint at a time is set to free mode."""
    LEAVE = "leave"
    """The arm is released as at the end of a session, and connected again."""
    SILENCE = "silence"
    """The operator's heartbeat is ended, as when this program is killed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckFinding(Clause):
    """A clause, with the stage in which it was checked."""

    stage: Stage


STOP: Final = "STOP"
"""Name of the clause that must pass before drives are enabled again."""
NOT_TESTED: Final = {
    "overload": "more joints in position mode than the mobility, with a fixture: they would overload each other",
    "faults": "count loss, nodes that restart or answer twice, modes refused: the virtual arm simulates all "
    "(sarcal controller --fault help)",
    "upload": "upload of a document and reading it back: it would replace the arm's own; `sarcal export --upload` "
    "reads back every upload",
    "closed chain": "two joints that move the others through a fixture: none on the bench; the first run tests this",
}
"""Requirements that cannot be tested on a bench, and why."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bench:
    """An arm on the bench, not yet connected, with the settings of the check."""

    arm: ArmInterface
    description: ArmDescription
    ask: Ask
    step_rad: float
    speed_rad_per_s: float
    interrupt: Callable[[], None]
    """Function that simulates Ctrl-C."""
    bounds: Bounds = clauses.BENCH

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.description.joints)


def check(bench: Bench, *, last: Stage) -> Iterator[CheckFinding]:
    """Check an arm up to and including stage `last`; yields findings. The caller must close the arm."""
    identity: ArmIdentity | None = None
    stages = _look, _hold, _move, _free, _leave, _silence
    for stage, run in zip(Stage, stages, strict=True):
        passed, names = True, set[str]()
        try:
            identity = identity or bench.arm.connect()
            for clause in run(bench, identity):
                names.add(clause.name)
                passed = passed and clause.passed is not False
                yield CheckFinding(stage=stage, **asdict(clause))
                if not passed and stage is not Stage.LOOK:
                    return  # no further motion after a failure with drives on
        except HardwareError as error:
            passed = False
            yield CheckFinding("no error", False, str(error), stage=stage)
        # Drives are not enabled without a tested STOP.
        if not passed or (stage is Stage.HOLD and STOP not in names):
            return
        if stage is last:
            break
    for name, reason in NOT_TESTED.items() if last is Stage.SILENCE else ():
        yield CheckFinding(name, None, f"not on a bench: {reason}", stage=Stage.SILENCE)


def _look(bench: Bench, identity: ArmIdentity) -> Iterator[Clause]:
    arm, n = bench.arm, bench.joints
    yield Clause("connect", True, f"{identity.model}, serial {identity.serial_number}")
    for text in identity.configured:
        yield Clause("configured", True, text)
    yield from clauses.identifies_itself(identity, bench.description.model, n)
    if isinstance(arm, CanopenArm):
        yield from checks.drive_settings(arm.access, arm.on_bus.profile)
    yield clauses.drives_off(arm)
    yield from clauses.has_valid_snapshot(arm, n)
    yield from clauses.goes_on(arm)
    if isinstance(arm, CanopenArm):
        yield from checks.keeps_time(arm, bench.bounds)
    yield from clauses.reads(arm, n, bench.bounds)
    for joint, sd in enumerate(arm.capture(bench.bounds.samples).sd_rad.tolist(), 1):
        text = f"the reading scatters by {clauses.deg(sd)} over {bench.bounds.samples} SYNCs"
        yield Clause("quiet", sd <= clauses.SCATTER_RAD, text, joint)
    yield from clauses.settles(arm, n, bench.bounds)
    go = partial(arm.move, {1: clauses.position_rad(arm, 1)}, speed_rad_per_s=bench.speed_rad_per_s)
    yield clauses.is_refused("no control", "a move before control is taken", go)
    text = "the arm stores no parameters"
    if parameter_bytes := len(arm.active_parameters()):
        text = f"the arm stores a parameter document of {parameter_bytes} bytes"
    yield Clause("parameters", True, text)
    if isinstance(arm, CanopenArm):
        yield checks.excludes_others(arm)


def _hold(bench: Bench, identity: ArmIdentity) -> Iterator[Clause]:
    arm = bench.arm
    if not bench.ask(
        "The drives will be enabled. Nothing should move, and then STOP is tried. Keep clear, with a hand "
        "on the emergency stop. Enable them?"
    ):
        text = "not tried: declined; without a tested STOP no later check is run"
        yield Clause("agreed", None, text)
        return
    before = arm.capture(bench.bounds.samples).mean_rad
    yield from clauses.is_enabled_unmoved(arm, bench.bounds)
    yield from clauses.reads_modes_back(arm, [JointMode.POSITION] * bench.joints)
    for joint, ends in enumerate(bench.description.joints, 1):
        yield from clauses.keeps_within_limits(arm, joint, ends, bench.speed_rad_per_s)
    if not identity.keeps_parameters or bench.ask(
        "An invalid parameter document will be sent to the controller, which must refuse it and keep its own. Send it?"
    ):
        yield from clauses.keeps_its_document(arm)
    else:
        yield clauses.declined()
    begun = time.monotonic()
    arm.stop()
    seconds, wrong = clauses.seconds_to_stop(arm, begun)
    yield clauses.nothing_wrong(
        STOP, wrong, f"all drives have stopped after {1e3 * seconds:.0f} ms"
    )
    yield from clauses.stays_stopped(arm, 1, bench.speed_rad_per_s)
    yield from clauses.resets_unmoved(arm, before, bench.bounds)
    before = arm.capture(bench.bounds.samples).mean_rad
    arm.take_control()
    yield clauses.is_still("holds after STOP", before, arm, bench.bounds)


def _move(bench: Bench, identity: ArmIdentity) -> Iterator[Clause]:
    if identity.by_hand:
        yield Clause("by hand", None, "not tried: this arm is moved by hand")
        return
    for joint in range(1, bench.joints + 1):
        yield from _turn(bench, joint)


def _turn(bench: Bench, joint: int) -> Iterator[Clause]:
    arm, speed = bench.arm, bench.speed_rad_per_s
    # A joint may come to rest up to half a step away from its target.
    bounds = replace(bench.bounds, near_rad=0.5 * bench.step_rad)
    start = arm.capture(bench.bounds.samples).mean_rad
    home, ends = float(start[joint - 1]), bench.description.joints[joint - 1]
    up = ends.upper_rad - home >= home - ends.lower_rad  # where more of the range is left
    way = bench.step_rad if up else -bench.step_rad
    if not bench.ask(
        f"Joint {joint} will turn by {clauses.deg(way, sign=True)} and back, twice, at {clauses.deg(speed)}/s, and be "
        "halted, interrupted and stopped on the way. Turn it?"
    ):
        yield clauses.declined(joint)
        return
    back = checks.Turn(
        arm=arm,
        joint=joint,
        target_rad=home,
        speed_rad_per_s=speed,
        bounds=bounds,
        part_rad=0.3 * abs(way),
    )
    outward = replace(back, target_rad=home + way)
    yield from checks.goes(outward)
    yield checks.moved_alone(start, arm.capture(bench.bounds.samples).mean_rad, joint, bounds)
    sense = "positive" if way > 0 else "negative"
    question = f"Did joint {joint}, and no other, turn in the {sense} sense of the arm file?"
    right, text = bench.ask(question), "the joint turned in the sense of the arm file"
    if not right:
        text = (
            "the joint turned otherwise: check direction and order of the joints in the bus profile"
        )
    yield Clause("direction", right, text, joint)
    yield from checks.halts(back)
    back.go()
    yield from checks.is_interrupted(outward, bench.interrupt)
    outward.go()
    yield from checks.is_stopped(back)
    arm.take_control()
    yield from checks.goes(back)


def _free(bench: Bench, _: ArmIdentity) -> Iterator[Clause]:
    arm = bench.arm
    for joint in range(1, bench.joints + 1):
        if not bench.ask(
            f"Joint {joint} will be set to free mode: it yields to a push, and to its weight. Support the arm. "
            "Free it?"
        ):
            yield clauses.declined(joint)
            continue
        modes = [JointMode.POSITION] * bench.joints
        modes[joint - 1] = JointMode.FREE
        arm.set_modes(modes)
        before = clauses.position_rad(arm, joint)
        yield Clause("frees", True, "the drive reports free mode", joint)
        yield clauses.refuses_to_move_free(arm, joint, bench.speed_rad_per_s)
        arm.hold()
        moved = clauses.deg(clauses.position_rad(arm, joint) - before, sign=True)
        text = f"the drive reports position mode again; in free mode the joint moved by {moved}"
        yield Clause("takes up", True, text, joint)


def _leave(bench: Bench, identity: ArmIdentity) -> Iterator[Clause]:
    if not bench.ask(
        "The arm will be released and connected again, as between two sessions. Its drives are switched off, and a "
        "joint without a brake may sink: support the arm. Release it?"
    ):
        yield clauses.declined()
        return
    before = bench.arm.capture(bench.bounds.samples).mean_rad
    yield from clauses.leaves_and_returns(bench.arm, identity)
    yield clauses.is_still("stays", before, bench.arm, bench.bounds)


def _silence(bench: Bench, _: ArmIdentity) -> Iterator[Clause]:
    if isinstance(bench.arm, CanopenArm):
        yield from checks.stops_alone(bench.arm, bench.ask, bench.bounds)
    else:
        yield Clause("guard", None, "not tried: only for an arm on a CAN bus")
