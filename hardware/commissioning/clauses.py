"""What every arm owes the workflow, at rest: each clause tries it and says how it came out.

Stated once, for `sarcal arm-check` and for the contract that packages with arms of their own run
(`sarcal.arm_contract`). Knows the `Arm` protocol; no bus, no order and no screen.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Final, Protocol

import numpy as np

from hardware.arm import Arm, ArmIdentity, DriveState, FloatArray, JointMode
from hardware.commissioning.finding import Bounds, Clause, deg, joints_words
from hardware.errors import CommandRefused, HardwareError, Stopped

STOPS_WITHIN_S: Final = 0.5
FRESH_S: Final = 1.0
LARGEST_RAD: Final = 4.0 * math.pi
NO_DOCUMENT: Final = b"no parameter document"
_WINDOW, _LONG_SYNCS, _SHORT_SYNCS = 5, 500, 20
_POLL_S: Final = 0.005


class Ranged(Protocol):
    """A joint as its file has it."""

    @property
    def lower_rad(self) -> float:
        """Lower end of its range."""
        ...

    @property
    def upper_rad(self) -> float:
        """Upper end of its range."""
        ...

    @property
    def max_speed_rad_per_s(self) -> float:
        """Fastest that it may be told to go."""
        ...


def names_itself(identity: ArmIdentity, model: str, joints: int) -> Iterator[Clause]:
    """It is the arm of the file, has a serial number, and a node or part for each joint, in order."""
    yield Clause(
        name="name",
        passed=identity.model == model,
        text=f"it is {identity.model!r}, and the arm file is of {model!r}",
    )
    yield Clause(
        name="serial",
        passed=bool(identity.serial_number.strip()),
        text=f"its serial number is {identity.serial_number!r}; poses of two arms must not get into one session",
    )
    roles = [node.role for node in identity.nodes if node.role.startswith("joint")]
    yield Clause(
        name="joints",
        passed=roles == [f"joint {j}" for j in range(1, joints + 1)],
        text=f"it names {', '.join(roles) or 'no joint'}",
    )


def is_pictured(arm: Arm, joints: int) -> Iterator[Clause]:
    """A snapshot has every joint in order, in radians, fresh and finite; no STOP is latched."""
    found = arm.snapshot()
    wrong = []
    if [joint.joint for joint in found.joints] != list(range(1, joints + 1)):
        wrong.append(f"{len(found.joints)} joints instead of {joints}, or in another order")
    if not (np.all(np.isfinite(found.positions_rad)) and np.all(np.isfinite(found.torques_nm))):
        wrong.append("a position or a torque is no number")
    elif np.abs(found.positions_rad).max(initial=0.0) >= LARGEST_RAD:
        wrong.append("a position is beyond two turns: angles are in radians")
    oldest_s = max((joint.age_s for joint in found.joints), default=0.0)
    if not 0.0 <= oldest_s < FRESH_S:
        wrong.append(f"a joint is {oldest_s:.2f} s old")
    if found.stopped:
        wrong.append("STOP is latched")
    yield Clause(
        name="picture",
        passed=not wrong,
        text="; ".join(wrong) or f"every joint is there; the oldest is {1e3 * oldest_s:.0f} ms old",
    )


def goes_on(arm: Arm) -> Iterator[Clause]:
    """Samples are counted on."""
    before = arm.snapshot().sync_count
    arm.capture(2)
    more = arm.snapshot().sync_count - before
    yield Clause(name="samples", passed=more > 0, text=f"a reading of 2 took {more} samples")


def reads(arm: Arm, joints: int, bounds: Bounds) -> Iterator[Clause]:
    """A reading is statistics over the samples asked for, of every joint, where the snapshot has it."""
    reading = arm.capture(bounds.samples)
    wrong = []
    if reading.samples != bounds.samples:
        wrong.append(f"{reading.samples} samples instead of {bounds.samples}")
    values = (reading.mean_counts, reading.mean_rad, reading.sd_rad)
    if any(v.shape != (joints,) or not np.all(np.isfinite(v)) for v in values):
        wrong.append("not a number for each joint")
    elif np.any(reading.sd_rad < 0.0):
        wrong.append("a negative standard deviation")
    else:
        apart = np.abs(reading.mean_rad - arm.snapshot().positions_rad)
        if apart.max(initial=0.0) > bounds.once_rad:
            wrong.append(f"the snapshot is {deg(float(apart.max()))} from it")
    yield Clause(
        name="reading",
        passed=not wrong,
        text="; ".join(wrong)
        or f"{bounds.samples} samples of {joints} joints, where the snapshot has them",
    )


def settles(arm: Arm, joints: int, bounds: Bounds) -> Iterator[Clause]:
    """At rest it settles; where nothing is allowed to spread, it does not."""
    wide = [bounds.once_rad] * joints
    rests = arm.settle(window=_WINDOW, spread_rad=wide, timeout_syncs=_LONG_SYNCS)
    never = arm.settle(window=_WINDOW, spread_rad=[-1.0] * joints, timeout_syncs=_SHORT_SYNCS)
    yield Clause(
        name="settles",
        passed=rests and not never,
        text=f"it {'rests' if rests else 'does not rest'} within {deg(wide[0])}"
        + (", and is said to rest within less than nothing" if never else ""),
    )


def is_enabled_unmoved(arm: Arm, bounds: Bounds) -> Iterator[Clause]:
    """Taking control enables every drive, in position mode, and moves nothing."""
    before = arm.capture(bounds.samples).mean_rad
    arm.take_control()
    joints = arm.snapshot().joints
    off = [j.joint for j in joints if j.drive is not DriveState.OPERATION_ENABLED]
    yield Clause(
        name="enable",
        passed=not off,
        text=f"{joints_words(off)} is not enabled" if off else "all drives are enabled",
    )
    yield from is_still("holds", before, arm.capture(bounds.samples).mean_rad, bounds)


def reads_modes_back(arm: Arm, modes: Sequence[JointMode]) -> Iterator[Clause]:
    """Every joint says that it has the mode it was given; and holds again."""
    arm.set_modes(modes)
    given = [j.joint for j, m in zip(arm.snapshot().joints, modes, strict=True) if j.mode is not m]
    arm.hold()
    held = [j.joint for j in arm.snapshot().joints if j.mode is not JointMode.POSITION]
    yield Clause(
        name="modes read back",
        passed=not given and not held,
        text=f"{joints_words(given or held)} says otherwise"
        if given or held
        else "every joint says that it has the mode it was given, and then that it holds",
    )


def is_refused(
    name: str,
    what: str,
    act: Callable[[], object],
    *,
    kind: type[HardwareError] = CommandRefused,
    joint: int | None = None,
) -> Clause:
    """Whether an act, harmless even where it is not refused, is refused in words."""
    try:
        act()
    except kind as error:
        return Clause(name=name, passed=True, text=f"{what} is refused: {error}", joint=joint)
    return Clause(name=name, passed=False, text=f"{what} was not refused", joint=joint)


def keeps_within_limits(
    arm: Arm, joint: int, ranged: Ranged, speed_rad_per_s: float
) -> Iterator[Clause]:
    """Targets beyond either end of a joint's range, and speeds above its own, are refused.

    Where one is not, the move ends with its first sample, or has no way to go.
    """
    here = arm.snapshot().joints[joint - 1].position_rad
    margin = math.radians(2.0)
    for beyond in (ranged.lower_rad - margin, ranged.upper_rad + margin):

        def go(target: float = beyond) -> object:
            return arm.move(
                {joint: target}, speed_rad_per_s=speed_rad_per_s, watch=lambda _: "not refused"
            )

        yield is_refused("range", f"a target of {deg(beyond, sign=True)}", go, joint=joint)
    fast = 2.0 * ranged.max_speed_rad_per_s
    yield is_refused(
        "speed",
        f"a move at {deg(fast)}/s",
        lambda: arm.move({joint: here}, speed_rad_per_s=fast, watch=lambda _: "not refused"),
        joint=joint,
    )


def refuses_to_move_free(arm: Arm, joint: int, speed_rad_per_s: float) -> Clause:
    """A joint that is free is not moved; it is asked to go where it is."""
    here = arm.snapshot().joints[joint - 1].position_rad
    return is_refused(
        "free stays free",
        "to move it while it is free",
        lambda: arm.move({joint: here}, speed_rad_per_s=speed_rad_per_s),
        joint=joint,
    )


def keeps_its_document(arm: Arm) -> Iterator[Clause]:
    """What is no parameter document is refused, and what is kept stays."""
    before = arm.active_parameters()
    yield is_refused(
        "document", "what is no parameter document", _uploading(arm), kind=HardwareError
    )
    after = arm.active_parameters()
    text = f"its document of {len(before)} bytes is as it was"
    if after != before:
        text = f"it kept {len(after)} bytes of that in the place of "
        if before:
            arm.upload_parameters(before)
            text += f"{len(before)}, which were uploaded again"
        else:
            text += "none: whatever reads its parameters takes it for one; export a document to it"
    yield Clause(name="keeps", passed=after == before, text=text)


def _uploading(arm: Arm) -> Callable[[], object]:
    return lambda: arm.upload_parameters(NO_DOCUMENT)


def stays_stopped(arm: Arm, joint: int, speed_rad_per_s: float) -> Iterator[Clause]:
    """STOP, once pressed, is latched: nothing is moved and nothing enabled."""
    here = arm.snapshot().joints[joint - 1].position_rad
    yield Clause(
        name="STOP latches",
        passed=arm.snapshot().stopped,
        text="it says that STOP is latched" if arm.snapshot().stopped else "STOP is not latched",
    )
    yield is_refused(
        "no move stopped",
        "a move",
        lambda: arm.move({joint: here}, speed_rad_per_s=speed_rad_per_s),
        kind=Stopped,
    )
    yield is_refused("no drive stopped", "to enable the drives", arm.take_control, kind=Stopped)


def resets_unmoved(arm: Arm, before: FloatArray, bounds: Bounds) -> Iterator[Clause]:
    """The reset of STOP leaves the drives off, and moves nothing; `before` is where the joints were.

    A joint settles in its brake, or against its blocked valve.
    """
    arm.reset_stop()
    found = arm.snapshot()
    on = [j.joint for j in found.joints if j.drive is DriveState.OPERATION_ENABLED]
    wrong = ["STOP is still latched"] * found.stopped + [f"{joints_words(on)} is enabled"] * bool(
        on
    )
    yield Clause(
        name="reset",
        passed=not wrong,
        text="; ".join(wrong) or "the reset lifts STOP, and leaves the drives off",
    )
    settled = replace(bounds, still_rad=bounds.once_rad)
    yield from is_still("reset holds", before, arm.capture(bounds.samples).mean_rad, settled)


def leaves_and_returns(arm: Arm, identity: ArmIdentity) -> Iterator[Clause]:
    """It closes with a word, twice; says nothing then; connects again as the same arm, its drives off."""
    words = [arm.close(), arm.close()]
    yield Clause(
        name="closes",
        passed=all(words),
        text="it is held and closed, also when told twice"
        if all(words)
        else "it did not answer when it was told to hold, or some drive did not let go",
    )
    yield is_refused("closed", "to look at a closed arm", arm.snapshot, kind=HardwareError)
    again = arm.connect()
    same = replace(again, configured=()) == replace(identity, configured=())
    yield Clause(
        name="same arm",
        passed=same,
        text="it connects again as the same arm"
        if same
        else f"it connects again as {again}, and was {identity}",
    )
    # Between the two a person may have unbolted the hand.
    yield drives_off(arm)


def drives_off(arm: Arm) -> Clause:
    """No drive is enabled."""
    on = [j.joint for j in arm.snapshot().joints if j.drive is DriveState.OPERATION_ENABLED]
    text = f"{joints_words(on)} is enabled" if on else "no drive is enabled"
    return Clause(name="drives off", passed=not on, text=text)


def is_still(name: str, before: FloatArray, after: FloatArray, bounds: Bounds) -> Iterator[Clause]:
    """No joint has turned between two readings."""
    gone = np.abs(after - before)
    most = float(gone.max(initial=0.0))
    yield Clause(
        name=name,
        passed=most <= bounds.still_rad,
        text=f"no joint turned by more than {deg(most)} (joint {int(np.argmax(gone)) + 1})",
    )


def seconds_to_stop(arm: Arm, begun_s: float) -> float | None:
    """Seconds until no drive is enabled; None if that takes too long."""
    while (seconds := time.monotonic() - begun_s) < STOPS_WITHIN_S:
        joints = arm.snapshot().joints
        if all(joint.drive is not DriveState.OPERATION_ENABLED for joint in joints):
            return seconds
        threading.Event().wait(_POLL_S)
    return None
