"""Requirements on any arm at rest, each tested by one function.

`sarcal arm-check` and the contract test for arms of other packages (`sarcal.arm_contract`) use these functions.
"""

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from hardware.arm import ArmIdentity, ArmInterface, DriveState, FloatArray, JointMode
from hardware.arm_description import JointDescription
from hardware.errors import CommandRefused, HardwareError, Stopped

Ask = Callable[[str], bool]
"""Asks the person beside the arm a question; returns whether the answer is yes."""
STOPS_WITHIN_S: Final = 0.5
FRESH_S: Final = 1.0
LARGEST_READING_RAD: Final = 4.0 * math.pi
NO_DOCUMENT: Final = b"no parameter document"
_WINDOW, _LONG_SYNCS, _SHORT_SYNCS = 5, 500, 20
_POLL_S: Final = 0.005


@dataclass(frozen=True, slots=True)
class Clause:
    """Result of the check of one requirement; `passed` is None if the requirement could not be tested."""

    name: str
    passed: bool | None
    text: str
    joint: int | None = None


SCATTER_RAD: Final = math.radians(0.5)
"""Limit of the standard deviation of single samples, mostly RVDT noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """Samples per reading, and two limits: motion of a joint at rest (`still_rad`), error after a move (`near_rad`)."""

    samples: int
    still_rad: float
    near_rad: float

    @property
    def single_sample_rad(self) -> float:
        """Largest error that a single sample at rest may have, rad."""
        return max(self.still_rad, self.near_rad, SCATTER_RAD)


BENCH: Final = Bounds(samples=100, still_rad=math.radians(0.1), near_rad=math.radians(0.5))
"""Limits for an arm without fixture."""


def nothing_wrong(name: str, wrong: str, otherwise: str) -> Clause:
    """Return a clause that has failed, with text `wrong`; if `wrong` is empty, it has passed, with text `otherwise`."""
    return Clause(name, not wrong, wrong or otherwise)


def position_rad(arm: ArmInterface, joint: int) -> float:
    """Return the position of a joint, rad."""
    return arm.snapshot().joints[joint - 1].position_rad


def enabled_joints(arm: ArmInterface) -> list[int]:
    """Return the joints whose drives are enabled."""
    joints = arm.snapshot().joints
    return [joint.joint for joint in joints if joint.drive is DriveState.OPERATION_ENABLED]


def declined(joint: int | None = None) -> Clause:
    """Return the result of a check that the person beside the arm declined."""
    return Clause("agreed", None, "not tried: declined", joint)


def deg(angle_rad: float, *, sign: bool = False) -> str:
    """Format an angle in degrees."""
    return f"{math.degrees(angle_rad):{'+' if sign else ''}.3f} deg"


def joints_words(joints: list[int], text: str) -> str:
    """Return `text` with the joints as its subject, such as ``joint 1, 3 is enabled``; empty if there are no joints."""
    return f"joint {', '.join(map(str, joints))} {text}" if joints else ""


def identifies_itself(identity: ArmIdentity, model: str, joints: int) -> Iterator[Clause]:
    """Check that the arm reports the arm file's model, a serial number, and its joints in order."""
    text = f"the arm reports the model {identity.model!r}; the arm file describes {model!r}"
    yield Clause("name", identity.model == model, text)
    serial = identity.serial_number
    text = f"the arm's serial number is {serial!r}; it must distinguish the poses of two arms"
    yield Clause("serial", bool(serial.strip()), text)
    roles = [node.role for node in identity.nodes if node.role.startswith("joint")]
    text = f"the arm names {', '.join(roles) or 'no joint'}"
    yield Clause("joints", roles == [f"joint {j}" for j in range(1, joints + 1)], text)


def has_valid_snapshot(arm: ArmInterface, joints: int) -> Iterator[Clause]:
    """Check that the snapshot has all joints in order, with finite, recent positions in rad, and no latched STOP."""
    snapshot = arm.snapshot()
    wrong = []
    if [joint.joint for joint in snapshot.joints] != list(range(1, joints + 1)):
        wrong.append(f"{len(snapshot.joints)} joints instead of {joints}, or not in order")
    if not np.all(np.isfinite([snapshot.positions_rad, snapshot.torques_nm])):
        wrong.append("a position or a torque is not finite")
    elif np.abs(snapshot.positions_rad).max(initial=0.0) >= LARGEST_READING_RAD:
        wrong.append("a position is beyond two turns: angles must be in radians")
    oldest_s = max((joint.age_s for joint in snapshot.joints), default=0.0)
    if not 0.0 <= oldest_s < FRESH_S:
        wrong.append(f"the data of a joint are {oldest_s:.2f} s old")
    if snapshot.stopped:
        wrong.append("STOP is latched")
    fine = f"every joint is present; the oldest data are {1e3 * oldest_s:.0f} ms old"
    yield nothing_wrong("picture", "; ".join(wrong), fine)


def goes_on(arm: ArmInterface) -> Iterator[Clause]:
    """Check that the sample counter advances."""
    before = arm.snapshot().sync_count
    arm.capture(2)
    more = arm.snapshot().sync_count - before
    yield Clause("samples", more > 0, f"a reading of 2 took {more} samples")


def reads(arm: ArmInterface, joints: int, bounds: Bounds) -> Iterator[Clause]:
    """Check that a reading has the requested number of samples, has finite values, and agrees with the snapshot."""
    reading = arm.capture(bounds.samples)
    wrong = []
    if reading.samples != bounds.samples:
        wrong.append(f"{reading.samples} samples instead of {bounds.samples}")
    values = (reading.mean_counts, reading.mean_rad, reading.sd_rad)
    if any(v.shape != (joints,) or not np.all(np.isfinite(v)) for v in values):
        wrong.append("not one finite number for each joint")
    elif np.any(reading.sd_rad < 0.0):
        wrong.append("a negative standard deviation")
    else:
        apart = np.abs(reading.mean_rad - arm.snapshot().positions_rad)
        if apart.max(initial=0.0) > bounds.single_sample_rad:
            wrong.append(f"the reading differs from the snapshot by {deg(float(apart.max()))}")
    fine = f"{bounds.samples} samples of {joints} joints, equal to the snapshot"
    yield nothing_wrong("reading", "; ".join(wrong), fine)


def settles(arm: ArmInterface, joints: int, bounds: Bounds) -> Iterator[Clause]:
    """Check that `settle` returns true for an arm at rest, and false for a negative spread, which is impossible."""
    wide = [bounds.single_sample_rad] * joints
    rests = arm.settle(window=_WINDOW, spread_rad=wide, timeout_syncs=_LONG_SYNCS)
    never = arm.settle(window=_WINDOW, spread_rad=[-1.0] * joints, timeout_syncs=_SHORT_SYNCS)
    text = f"the arm {'rests' if rests else 'does not rest'} within {deg(wide[0])}"
    if never:
        text += ", and reports settling within a negative spread"
    yield Clause("settles", rests and not never, text)


def is_enabled_unmoved(arm: ArmInterface, bounds: Bounds) -> Iterator[Clause]:
    """Check that taking control enables every drive in position mode without motion."""
    before = arm.capture(bounds.samples).mean_rad
    arm.take_control()
    joints, on = arm.snapshot().joints, enabled_joints(arm)
    off = [j.joint for j in joints if j.joint not in on]
    yield nothing_wrong("enable", joints_words(off, "is not enabled"), "all drives are enabled")
    other_mode = [j.joint for j in joints if j.mode is not JointMode.POSITION]
    must = "is not in position mode; once enabled, a drive must hold its joint in this mode"
    fine = "all drives are in position mode"
    yield nothing_wrong("holding mode", joints_words(other_mode, must), fine)
    yield is_still("holds", before, arm, bounds)


def reads_modes_back(arm: ArmInterface, modes: Sequence[JointMode]) -> Iterator[Clause]:
    """Set `modes`, then call `hold`; check that every joint reports first the requested mode, then position mode."""

    def other_than(expected: Sequence[JointMode]) -> list[int]:
        joints = zip(arm.snapshot().joints, expected, strict=True)
        return [joint.joint for joint, mode in joints if joint.mode is not mode]

    arm.set_modes(modes)
    others = other_than(modes)
    arm.hold()
    others = others or other_than([JointMode.POSITION] * len(modes))
    wrong = joints_words(others, "reports another mode")
    fine = "every joint reports the requested mode, then position mode"
    yield nothing_wrong("modes read back", wrong, fine)


def is_refused(
    name: str,
    what: str,
    act: Callable[[], object],
    *,
    kind: type[HardwareError] = CommandRefused,
    joint: int | None = None,
) -> Clause:
    """Check that an action is refused with an error of type `kind`; the action must be harmless if carried out."""
    try:
        act()
    except kind as error:
        return Clause(name, True, f"{what} is refused: {error}", joint)
    return Clause(name, False, f"{what} was not refused", joint)


def keeps_within_limits(
    arm: ArmInterface, joint: int, limits: JointDescription, speed_rad_per_s: float
) -> Iterator[Clause]:
    """Check that targets beyond the range and speeds above the limit are refused.

    If the arm accepts such a command, a watch function ends the move at the first sample.
    """
    margin, fast = math.radians(2.0), 2.0 * limits.max_speed_rad_per_s
    beyond = (limits.lower_rad - margin, limits.upper_rad + margin)
    for name, what, target, speed in (
        *(("range", f"a target of {deg(end, sign=True)}", end, speed_rad_per_s) for end in beyond),
        ("speed", f"a move at {deg(fast)}/s", position_rad(arm, joint), fast),
    ):
        go = partial(
            arm.move, {joint: target}, speed_rad_per_s=speed, watch=lambda _: "not refused"
        )
        yield is_refused(name, what, go, joint=joint)


def refuses_to_move_free(arm: ArmInterface, joint: int, speed_rad_per_s: float) -> Clause:
    """Check that a joint in free mode cannot be commanded to move; the target is the joint's current position."""
    go = partial(arm.move, {joint: position_rad(arm, joint)}, speed_rad_per_s=speed_rad_per_s)
    return is_refused("free stays free", "a move in free mode", go, joint=joint)


def keeps_its_document(arm: ArmInterface) -> Iterator[Clause]:
    """Check that an invalid parameter document is refused and the stored one is unchanged."""
    before = arm.active_parameters()
    upload = partial(arm.upload_parameters, NO_DOCUMENT)
    yield is_refused("document", "an invalid parameter document", upload, kind=HardwareError)
    after = arm.active_parameters()
    wrong, stored = "", f"the controller stored {len(after)} bytes of the invalid document"
    if after != before and before:
        arm.upload_parameters(before)
        former = f"its document of {len(before)} bytes"
        wrong = f"{stored} in place of {former}; that document has been uploaded again"
    elif after != before:
        wrong = f"{stored} and had no document before: export a valid document to it"
    fine = f"the stored document of {len(before)} bytes is unchanged"
    yield nothing_wrong("keeps", wrong, fine)


def stays_stopped(arm: ArmInterface, joint: int, speed_rad_per_s: float) -> Iterator[Clause]:
    """Check that STOP is latched, and that a move and the enabling of drives are refused."""
    wrong = "" if arm.snapshot().stopped else "STOP is not latched"
    yield nothing_wrong("STOP latches", wrong, "the arm reports that STOP is latched")
    go = partial(arm.move, {joint: position_rad(arm, joint)}, speed_rad_per_s=speed_rad_per_s)
    yield is_refused("no move stopped", "a move", go, kind=Stopped)
    yield is_refused("no drive stopped", "to enable the drives", arm.take_control, kind=Stopped)


def resets_unmoved(arm: ArmInterface, before: FloatArray, bounds: Bounds) -> Iterator[Clause]:
    """Check that a reset of STOP enables no drive, and that the joints stay at `before` (n,), rad."""
    arm.reset_stop()
    latched = "STOP is still latched" if arm.snapshot().stopped else ""
    wrong = "; ".join(filter(None, (latched, joints_words(enabled_joints(arm), "is enabled"))))
    yield nothing_wrong("reset", wrong, "the reset releases STOP and leaves the drives off")
    settled = replace(bounds, still_rad=bounds.single_sample_rad)
    yield is_still("reset holds", before, arm, settled)


def leaves_and_returns(arm: ArmInterface, identity: ArmIdentity) -> Iterator[Clause]:
    """Check that `close` may be called twice, and that connecting again finds the same arm with its drives off."""
    held = all([arm.close(), arm.close()])
    wrong = "the arm did not answer when it was closed, or a drive still follows commands"
    fine = "the arm is held and closed, also when it is closed twice"
    yield nothing_wrong("closes", "" if held else wrong, fine)
    yield is_refused("closed", "a snapshot of a closed arm", arm.snapshot, kind=HardwareError)
    again = arm.connect()
    same = replace(again, configured=()) == replace(identity, configured=())
    wrong = f"the arm connects again as {again}; before, it was {identity}"
    yield nothing_wrong("same arm", "" if same else wrong, "the arm connects again as the same arm")
    yield drives_off(arm)  # a person may have unbolted the tool meanwhile


def drives_off(arm: ArmInterface) -> Clause:
    """Check that no drive is enabled."""
    on = joints_words(enabled_joints(arm), "is enabled")
    return nothing_wrong("drives off", on, "no drive is enabled")


def is_still(name: str, before: FloatArray, arm: ArmInterface, bounds: Bounds) -> Clause:
    """Check that no joint has moved since the reading `before` (n,), rad."""
    gone = np.abs(arm.capture(bounds.samples).mean_rad - before)
    most = float(gone.max(initial=0.0))
    text = f"no joint moved by more than {deg(most)} (joint {int(np.argmax(gone)) + 1})"
    return Clause(name, most <= bounds.still_rad, text)


def seconds_to_stop(arm: ArmInterface, begun_s: float) -> tuple[float, str]:
    """Wait until all drives are disabled, or until `STOPS_WITHIN_S` seconds after the monotonic time `begun_s`.

    Returns the seconds since `begun_s`, and a sentence that names the joints still enabled (empty if there are none).
    """
    while True:
        seconds, enabled = time.monotonic() - begun_s, enabled_joints(arm)
        if not enabled or seconds >= STOPS_WITHIN_S:
            wrong = joints_words(enabled, f"is still enabled {STOPS_WITHIN_S:g} s after STOP")
            return seconds, wrong
        threading.Event().wait(_POLL_S)
