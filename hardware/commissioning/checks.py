"""Checks during motion (an arm reaches targets, and can be halted on the way), and checks of an arm on a CAN bus.

`sarcal arm-check` and the contract test for arms of other packages use these checks and those of `clauses`.
"""

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from hardware.arm import ArmInterface, ArmSnapshot, DriveState, MoveResult, Watch
from hardware.canopen import objects
from hardware.canopen.bus_profile import BusProfile
from hardware.canopen.drive_settings import (
    NO_FOLLOWING_WINDOW,
    ignores_operator_timeout,
    operator_timeout_s,
)
from hardware.canopen.maps import read_number
from hardware.canopen.sdo import ObjectAccess
from hardware.commissioning import clauses
from hardware.commissioning.clauses import Ask, Bounds, Clause, deg
from hardware.control.canopen_arm import CanopenArm
from hardware.errors import BusError, ControlDenied, HardwareError, OtherMaster, Stopped
from hardware.timing import Pace

_WINDOW, _LONG_SYNCS = 5, 1000
_IN_FLIGHT_S: Final = 0.5
"""Time allowed for an interrupt to arrive."""
ENOUGH: Final = "that is enough"


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn:
    """Test motion of one joint to `target_rad`, with limits; `part_rad`: angle after which a `MidwayWatch` acts."""

    arm: ArmInterface
    joint: int
    target_rad: float
    speed_rad_per_s: float
    bounds: Bounds
    part_rad: float = 0.0

    def go(self, watch: Watch | None = None) -> MoveResult:
        """Move the joint to `target_rad`."""
        return self.arm.move(
            {self.joint: self.target_rad}, speed_rad_per_s=self.speed_rad_per_s, watch=watch
        )


class MidwayWatch:
    """A watch function that calls `act` once, as soon as the joint of `turn` has moved by its `part_rad`."""

    def __init__(self, turn: Turn, act: Callable[[], str | None]) -> None:
        self._turn, self._act = turn, act
        start = turn.arm.capture(turn.bounds.samples).mean_rad
        self.start_rad = self.at_rad = float(start[turn.joint - 1])
        """Position at the start, and the position at which `act` was called (before that, the start)."""
        self.acted = False

    def __call__(self, snapshot: ArmSnapshot) -> str | None:
        """Return the result of `act` when the joint has moved by `part_rad` for the first time, otherwise None."""
        position_rad = float(snapshot.positions_rad[self._turn.joint - 1])
        if self.acted or abs(position_rad - self.start_rad) < self._turn.part_rad:
            return None
        self.acted, self.at_rad = True, position_rad
        return self._act()

    def overtravel(self) -> str:
        """Return a text that says how far the joint moved after `act` was called, before it came to rest."""
        position_rad = float(self._turn.arm.capture(1).mean_rad[self._turn.joint - 1])
        return f"the joint came to rest after a further {deg(abs(position_rad - self.at_rad))}"


def goes(turn: Turn) -> Iterator[Clause]:
    """Check that a joint reaches its target and comes to rest."""
    arm, joint, bounds = turn.arm, turn.joint, turn.bounds
    start = arm.capture(bounds.samples).mean_rad
    way = turn.target_rad - float(start[joint - 1])
    outcome = turn.go()
    spread = [bounds.single_sample_rad] * len(start)
    rests = arm.settle(window=_WINDOW, spread_rad=spread, timeout_syncs=_LONG_SYNCS)
    went = float(arm.capture(bounds.samples).mean_rad[joint - 1] - start[joint - 1])
    passed = outcome.reached and rests and abs(went - way) <= bounds.near_rad
    text = f"commanded to turn by {deg(way, sign=True)}, it reads {deg(went, sign=True)}"
    if not outcome.reached:
        text += f", and reports {outcome.reason!r}"
    if not rests:
        text += ", and does not come to rest"
    yield Clause("moves", passed, text, joint)


def halts(turn: Turn) -> Iterator[Clause]:
    """Check that a watch function can end a move, and that the move returns its reason."""
    watch = MidwayWatch(turn, lambda: ENOUGH)
    outcome = turn.go(watch)
    halted = not outcome.reached and outcome.reason == ENOUGH
    text = f"a watch could not end the move, which reports {outcome.reason!r}"
    if halted:
        text = f"a watch ended the move; {watch.overtravel()}"
    yield Clause("halts", halted, text, turn.joint)


def is_interrupted(turn: Turn, interrupt: Callable[[], None]) -> Iterator[Clause]:
    """Check that Ctrl-C during a move leaves the arm holding with its drives on."""
    watch = MidwayWatch(turn, interrupt)
    interrupted = False
    try:
        turn.go(watch)
        threading.Event().wait(_IN_FLIGHT_S)
    except KeyboardInterrupt:
        if not watch.acted:  # pressed by the user
            raise
        interrupted = True
    snapshot = turn.arm.snapshot()
    enabled = len(clauses.enabled_joints(turn.arm)) == len(snapshot.joints)
    text = "the move was not interrupted"
    if interrupted:
        text = f"{watch.overtravel()}; the drives are {'on' if enabled else 'off'}"
    passed = interrupted and enabled and not snapshot.moving
    yield Clause("Ctrl-C", passed, text, turn.joint)
    before = turn.arm.capture(turn.bounds.samples).mean_rad
    yield clauses.is_still("held", before, turn.arm, turn.bounds)


def is_stopped(turn: Turn) -> Iterator[Clause]:
    """Check that STOP from another thread ends a move and latches, and that a reset causes no motion."""
    arm, joint, bounds = turn.arm, turn.joint, turn.bounds

    def press() -> None:
        presser = threading.Thread(target=arm.stop)
        presser.start()
        presser.join()

    watch = MidwayWatch(turn, press)
    try:
        turn.go(watch)
        stopped = False
    except Stopped:
        stopped = True
    _, still_enabled = clauses.seconds_to_stop(arm, time.monotonic())
    rests = arm.snapshot().positions_rad  # a stopped arm cannot take a reading
    gone = abs(float(rests[joint - 1]) - watch.start_rad)
    at = abs(watch.at_rad - watch.start_rad)
    near = gone - at <= max(turn.part_rad, bounds.single_sample_rad)
    text = f"the joint came to rest {deg(abs(gone - at))} after STOP"
    if not stopped:
        text = "STOP did not end the move"
    elif still_enabled:
        text = still_enabled
    yield Clause("STOP on the way", stopped and not still_enabled and near, text, joint)
    yield from clauses.stays_stopped(arm, joint, turn.speed_rad_per_s)
    yield from clauses.resets_unmoved(arm, rests, bounds)


def moved_alone(before: np.ndarray, after: np.ndarray, joint: int, bounds: Bounds) -> Clause:
    """Check that no joint except `joint` moved between two readings (n,), rad."""
    most = float(np.delete(np.abs(after - before), joint - 1).max(initial=0.0))
    text = f"no other joint moved by more than {deg(most)}"
    return Clause("alone", most <= max(bounds.still_rad, bounds.near_rad), text, joint)


HOLDS_AFTER_STOP: Final = 5
"""From this value of 605Ah on, the drive stays in *quick stop active*; below it, the joint is released."""
PERIOD_TOLERANCE: Final = 0.2
"""Relative tolerance of the mean SYNC period."""


def drive_settings(access: ObjectAccess, profile: BusProfile) -> Iterator[Clause]:
    """Check the drives' modes, quick stop option, operator time-out and following error window."""
    # Codes below 0 are the maker's own modes, which have no bit.
    codes = [code for code in sorted(profile.mode_codes.values()) if code > 0]
    for joint, node in enumerate(profile.drives, 1):
        supported = read_number(access, node, objects.SUPPORTED_MODES, 0)
        passed, text = None, "the drive has no 6502h (supported modes)"
        if supported is not None:
            lacking = [str(code) for code in codes if not supported >> (code - 1) & 1]
            lacks = f"6502h lacks mode {', '.join(lacking)}"
            passed, text = not lacking, lacks if lacking else "6502h has both modes"
        yield Clause("modes", passed, text, joint)
        option = read_number(access, node, objects.QUICK_STOP_OPTION, 0)
        passed, text = None, "the drive has no 605Ah (quick stop option)"
        if option is not None:
            passed = option >= HOLDS_AFTER_STOP
            reaction = "holds" if passed else "releases the joint"
            text = f"605Ah = {option}: the drive {reaction} after a quick stop"
        yield Clause("quick stop", passed, text, joint)
        guard_s, ignored = operator_timeout_s(access, node), ignores_operator_timeout(access, node)
        yield Clause("guard", *_guard(guard_s, ignored=ignored), joint)
        if read_number(access, node, objects.FOLLOWING_WINDOW, 0) == NO_FOLLOWING_WINDOW:
            text = (
                "6065h = FFFFFFFFh: the drive does not check its following error, only this program does. Set 6065h "
                "to the error, in counts, at which the drive must trip"
            )
            yield Clause("following error", None, text, joint)


def _guard(guard_s: float | None, *, ignored: bool) -> tuple[bool | None, str]:
    """Return whether a drive's operator time-out is allowed, and a text; None if it is allowed but not advised."""
    if guard_s is None:
        text = "1016h: the drive does not monitor this program's heartbeat, and keeps moving if this program dies"
        return False, text
    if ignored:
        text = (
            "6007h = 0: the drive takes no action after its heartbeat time-out (1016h), and keeps moving if this "
            "program dies; set 6007h to 3 (quick stop)"
        )
        return False, text
    text = (
        f"1016h: the drive is set to react {guard_s:.2f} s after the last heartbeat of this program"
    )
    if guard_s > objects.MAX_OPERATOR_TIMEOUT_S:
        text += f"; a run requires at most {objects.MAX_OPERATOR_TIMEOUT_S:g} s"
        return False, text
    if guard_s > objects.ADVISED_OPERATOR_TIMEOUT_S:
        limit = f"advised: at most {objects.ADVISED_OPERATOR_TIMEOUT_S:g} s"
        text += f" ({limit}); if this program dies, the joint may move until then"
        return None, text
    return True, text


def keeps_time(arm: CanopenArm, bounds: Bounds) -> Iterator[Clause]:
    """Check that this computer sends SYNC with the configured mean period."""
    if arm.on_bus.pace is Pace.FAST_FORWARD:
        return
    before, begun = arm.snapshot().sync_count, time.monotonic()
    arm.capture(bounds.samples)
    mean_s = (time.monotonic() - begun) / max(arm.snapshot().sync_count - before, 1)
    within = abs(mean_s - objects.CONTROL_PERIOD_S) <= PERIOD_TOLERANCE * objects.CONTROL_PERIOD_S
    text = f"a SYNC every {1e3 * mean_s:.2f} ms, configured {1e3 * objects.CONTROL_PERIOD_S:g} ms"
    late = ": this computer is too busy, or its adapter too slow"
    yield Clause("period", True, text) if within else Clause("period", None, text + late)


def excludes_others(arm: CanopenArm) -> Clause:
    """Check that a second program cannot connect to the arm, and that the arm still answers this program afterwards."""
    other = CanopenArm(arm.on_bus)
    try:
        other.connect()
    except (ControlDenied, OtherMaster) as refused:
        passed, text = True, f"a second program is refused: {refused}"
    except BusError as error:
        passed, text = None, f"not tried: {error}"
    else:
        other.close()
        passed = False
        text = "a second program was let in, and this program's frames no longer reach the arm"
    if passed is not False:
        # The second program may have sent frames before it was refused or failed.
        try:
            arm.capture(2)
        except HardwareError as error:
            passed, text = False, f"a second program was let in, then failed: {error}"
    return Clause("one operator", passed, text)


def stops_alone(arm: CanopenArm, ask: Ask, bounds: Bounds) -> Iterator[Clause]:
    """Check that the drives stop and hold by themselves when the operator's heartbeat ends."""
    guards = [
        None if ignores_operator_timeout(arm.access, node) else operator_timeout_s(arm.access, node)
        for node in arm.on_bus.profile.drives
    ]
    longest = max((guard for guard in guards if guard is not None), default=0.0)
    if longest == 0.0 or None in guards:
        yield Clause(
            "guard", None, "not every drive monitors the operator's heartbeat and acts on its loss"
        )
        return
    if not ask(
        f"This program will fall silent for {2 * longest:.1f} s while the drives are enabled, as if it were "
        "killed. The drives should stop and hold by themselves. Keep clear. Fall silent?"
    ):
        yield clauses.declined()
        return
    arm.take_control()
    before = arm.capture(bounds.samples).mean_rad
    arm.fall_silent()
    threading.Event().wait(2 * longest)
    # Read before connecting again: the communication reset of a connection would stop the drives too.
    states = arm.read_states_unconnected()
    on = [j for j, state in enumerate(states, 1) if state is DriveState.OPERATION_ENABLED]
    arm.connect()
    faults = arm.snapshot().faults
    arm.reset_stop()  # the drives have tripped, and a tripped arm cannot take a reading
    reasons = sorted({f"{fault.text} ({fault.code:04X}h)" for fault in faults})
    wrong = clauses.joints_words(
        on, f"was still enabled {2 * longest:.1f} s after this program fell silent"
    )
    fine = f"no drive stayed enabled; faults: {', '.join(reasons) or 'none'}"
    yield clauses.nothing_wrong("stops alone", wrong, fine)
    yield clauses.is_still("held alone", before, arm, bounds)
