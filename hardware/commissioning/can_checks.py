"""Checks of an arm on a CAN bus: drive settings, SYNC period, a second operator, loss of the operator."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from typing import Final

from hardware.arm import DriveState
from hardware.canopen.drive_settings import DriveFacts
from hardware.canopen.objects import ADVISED_OPERATOR_TIMEOUT_S, MAX_OPERATOR_TIMEOUT_S
from hardware.commissioning.clauses import is_still
from hardware.commissioning.finding import Ask, Bounds, Clause, declined, joints_words
from hardware.control.canopen_arm import CanopenArm
from hardware.errors import BusError, ControlDenied, HardwareError, OtherMaster

HOLDS_AFTER_STOP: Final = 5
"""605Ah from which the drive stays in *quick stop active*; below, it releases the joint."""
PERIOD_TOLERANCE: Final = 0.2
"""Relative tolerance of the mean SYNC period."""


def drive_settings(facts: Sequence[DriveFacts]) -> Iterator[Clause]:
    """Modes, quick stop option and operator time-out of the drives."""
    for drive in facts:
        lacking, option = drive.unsupported_modes, drive.quick_stop_option
        yield Clause(
            name="modes",
            passed=None if lacking is None else not lacking,
            text="it has no 6502h (supported modes)"
            if lacking is None
            else f"6502h lacks mode {', '.join(map(str, lacking))}"
            if lacking
            else "6502h has both modes",
            joint=drive.joint,
        )
        yield Clause(
            name="quick stop",
            passed=None if option is None else option >= HOLDS_AFTER_STOP,
            text="it has no 605Ah (quick stop option)"
            if option is None
            else f"605Ah = {option}: it {'holds' if option >= HOLDS_AFTER_STOP else 'lets go'} after a "
            "quick stop",
            joint=drive.joint,
        )
        yield _guard(drive)


def _guard(drive: DriveFacts) -> Clause:
    """Operator time-out of a drive: fails if a run refuses it, undecided if above the advised one."""
    guard = drive.operator_timeout_s
    if guard is None:
        passed, text = (
            False,
            "1016h: it does not monitor the operator's heartbeat, and goes on when this program dies",
        )
    else:
        passed, text = True, f"1016h: it stops without the operator after {guard:.2f} s"
        if guard > MAX_OPERATOR_TIMEOUT_S:
            passed, text = (False, f"{text}; a run requires at most {MAX_OPERATOR_TIMEOUT_S:g} s")
        elif guard > ADVISED_OPERATOR_TIMEOUT_S:
            passed, text = (
                None,
                f"{text}; that long it goes on when this program dies (advised: {ADVISED_OPERATOR_TIMEOUT_S:g} s)",
            )
    return Clause(name="guard", passed=passed, text=text, joint=drive.joint)


def keeps_time(arm: CanopenArm, bounds: Bounds) -> Iterator[Clause]:
    """The mean SYNC period is as configured; a deviation is this computer's."""
    period_s = arm.real_period_s
    if period_s is None:  # fast forward
        return
    before, begun = arm.snapshot().sync_count, time.monotonic()
    arm.capture(bounds.samples)
    mean_s = (time.monotonic() - begun) / max(arm.snapshot().sync_count - before, 1)
    kept = abs(mean_s - period_s) <= PERIOD_TOLERANCE * period_s
    late = "" if kept else ": this computer is too busy, or its adapter too slow"
    yield Clause(
        name="period",
        passed=True if kept else None,
        text=f"a SYNC every {1e3 * mean_s:.2f} ms, wanted every {1e3 * period_s:g} ms{late}",
    )


def excludes_others(arm: CanopenArm) -> Clause:
    """A second program is refused before it sends anything, and this one goes on."""
    other = arm.another()
    try:
        other.connect()
    except (ControlDenied, OtherMaster) as refused:
        passed, text = True, f"a second program is refused: {refused}"
    except BusError as error:
        passed, text = None, f"not tried: {error}"
    else:
        other.close()
        passed, text = False, "a second program was let in: its frames pass, and ours do not"
    if passed is not False:
        # It may have sent frames before it was refused or failed.
        try:
            arm.capture(2)
        except HardwareError as error:
            passed, text = False, f"a second program was let in before it ended: {error}"
    return Clause(name="one operator", passed=passed, text=text)


def stops_alone(arm: CanopenArm, ask: Ask, bounds: Bounds) -> Iterator[Clause]:
    """Without the operator's heartbeat the drives stop and hold."""
    guards = [drive.operator_timeout_s for drive in arm.drive_facts()]
    longest = max((guard for guard in guards if guard is not None), default=0.0)
    if longest == 0.0 or None in guards:
        yield Clause(name="guard", passed=None, text="not every drive monitors the operator")
        return
    if not ask(
        f"This program will fall silent for {2 * longest:.1f} s while the drives are enabled, as if it were "
        "killed. They should stop and hold by themselves. Keep clear. Fall silent?"
    ):
        yield declined()
        return
    arm.take_control()
    before = arm.capture(bounds.samples).mean_rad
    arm.fall_silent()
    threading.Event().wait(2 * longest)
    # Before connecting: its communication reset would stop drives too.
    states = arm.read_states_unconnected()
    on = [j for j, state in enumerate(states, 1) if state is DriveState.OPERATION_ENABLED]
    arm.connect()
    faults = arm.snapshot().faults
    arm.reset_stop()  # the drives have tripped, and a tripped arm cannot be captured
    reasons = sorted({f"{fault.text} ({fault.code:04X}h)" for fault in faults})
    yield Clause(
        name="stops alone",
        passed=not on,
        text=f"{joints_words(on)} was still enabled {2 * longest:.1f} s after this program fell silent"
        if on
        else f"no drive stayed enabled; faults: {', '.join(reasons) or 'none'}",
    )
    yield from is_still("held alone", before, arm.capture(bounds.samples).mean_rad, bounds)
