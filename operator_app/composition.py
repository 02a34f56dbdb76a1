"""Opens the real or virtual arm of a session on its bus.

Without a bus, a session gets the embedded virtual arm: a controller in this process on a python-can ``virtual``
channel, with the same frames as on a real bus.
"""

import gc
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib import import_module
from itertools import count
from pathlib import Path

from fixtures.measured import Measured
from hardware.arm_description import (
    ArmDescription,
    EncoderDescription,
    JointDescription,
    RvdtDescription,
)
from hardware.arm_plugins import ArmOffer, ArmOrder, offer
from hardware.buses.python_can import ArmOnBus, BusSettings, open_bus
from hardware.control.canopen_arm import CanopenArm
from hardware.outside_arm import OutsideArm
from hardware.timing import Pace, Timing, real_time_priority
from hardware.virtual.controller import VirtualController
from hardware.virtual.embedded_bus import attended_opener
from operator_app.config.procedure import Procedure
from operator_app.errors import SessionError
from operator_app.exit_codes import UsageError
from operator_app.safe_output import say
from operator_app.session.workflow.opening import (
    Choices,
    Opening,
    Rig,
    open_session,
    remove_if_empty,
)
from operator_app.session.workflow.pose_reading import Instrument, port_of
from operator_app.session.workflow.session import Session
from operator_app.signals import ending_signals_ignored, ending_signals_interrupt
from operator_app.virtual_arms import run_controller, true_values, virtual_instrument
from solver.chain.arm_model import ArmModel
from solver.chain.sensors import Encoder, NoSensor, Rvdt

EMBEDDED_TIMEOUT_S = 10.0
"""Timeout of heartbeats, answers and SDOs for the embedded arm, which shares the processor with this program."""
SWITCH_INTERVAL_S = 0.0005
"""Thread switch interval of the interpreter, so short that SYNC does not wait for a solver or a repaint."""

COMPILED = ("scipy.linalg", "scipy.special", "scipy.sparse.csgraph", "scipy.spatial")
"""Libraries loaded before an arm is live: loading one later would block the interpreter for 10 to 40 ms."""

_channels = count(1)


@cache
def prepare_real_time() -> None:
    """Prevent pauses that would delay SYNC: switch threads often, collect garbage rarely, import slow libraries now."""
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    for library in COMPILED:
        import_module(library)
    # A full garbage collection takes 0.1 s or more, during which no SYNC is answered and no STOP is sent. Without full
    # collections, each closed dialog keeps 0.4 MB. Young objects are collected as usual.
    gc.freeze()
    young, middle, _ = gc.get_threshold()
    gc.set_threshold(young, middle, 100_000)


@contextmanager
def open_arm(
    opening: Opening, *, pace: Pace | None = None, speed: float = 1.0, record_to: Path | None = None
) -> Iterator[Rig]:
    """Open the arm of a session and yield it as a `Rig`; start the controller of an embedded virtual arm.

    `pace`: real time or fast-forward. None means fast-forward for the embedded virtual arm, real time for all others.
    `speed`: how many times faster than a real arm the embedded virtual arm runs; without effect in fast-forward.

    Raises `BusError` if the bus cannot be opened, and `UsageError` if a channel or bitrate is chosen without an
    interface. Raises `SessionError` if the session was imported and has no arm, or if its files or options do not suit
    the arm.
    """
    if opening.state.imported:
        raise SessionError(
            f"{opening.folder} was imported from {opening.state.imported}: it cannot be continued with an arm",
            "calibrate the arm in a session of its own: sarcal run",
        )
    prepare_real_time()
    procedure, stated = opening.effective_procedure, opening.choices
    bus = settings = stated.bus(procedure)
    embedded = bus.interface == "virtual"
    if embedded and stated.interface is None and (stated.channel or stated.bitrate):
        option = f"-c {stated.channel}" if stated.channel else f"-b {stated.bitrate}"
        raise UsageError(
            f"{option}: no interface is named, and the simulated arm has no bus; add -i, such as -i socketcan"
        )
    outside = offer(bus.interface)
    stores = (
        procedure.profile.supervisor is not None if outside is None else outside.keeps_parameters
    )
    # If nothing stores parameters, they stay in the session folder.
    procedure = replace(procedure, upload=procedure.upload and stores)
    choices = _completed(stated, bus, embedded=embedded)
    completed = replace(opening, procedure=procedure, choices=choices)
    if outside is not None:
        with closing(_outside_arm(outside, completed, bus, record_to)) as outside_arm:
            instrument = _instrument(procedure, choices, None)
            yield Rig(arm=outside_arm, opening=completed, simulated=False, instrument=instrument)
        return
    controller: VirtualController | None = None
    with ExitStack() as stack:
        if embedded:
            channel = f"sarcal-{os.getpid()}-{next(_channels)}"
            settings = BusSettings(interface="virtual", channel=channel)
            controller = stack.enter_context(
                run_controller(
                    opening.procedure.arm,
                    stated,
                    settings,
                    fixture=opening.procedure.fixture,
                    placement=opening.state.placement,
                    heartbeat_timeout_s=EMBEDDED_TIMEOUT_S,
                    attended=True,
                )
            )
            opener = attended_opener(controller)
        else:
            opener = open_bus
            stack.enter_context(real_time_priority())
        on_bus = ArmOnBus(
            describe(procedure.arm),
            settings,
            procedure.profile,
            pace=pace or (Pace.FAST_FORWARD if embedded else Pace.REAL_TIME),
            timing=_timing(procedure, speed=speed, embedded=embedded),
            open_main=opener,
        )
        arm = CanopenArm(on_bus, record_to=record_to)
        stack.callback(lambda: print_recording_problem(arm.record_to, arm.recording_failure))
        stack.callback(arm.close)
        yield Rig(
            arm=arm,
            opening=completed,
            simulated=embedded,
            instrument=_instrument(procedure, stated, controller),
            truths=partial(true_values, procedure.arm, procedure.fixture, stated)
            if embedded
            else None,
            recording_ended=lambda: _recording_problem(arm.record_to, arm.recording_failure),
        )


def _outside_arm(
    offer: ArmOffer, opening: Opening, bus: BusSettings, record_to: Path | None
) -> OutsideArm:
    if record_to is not None and not offer.records:
        raise SessionError(
            f"the arm {bus.interface!r} cannot record its bus",
            "leave --record out; all poses are in the journal",
        )
    order = ArmOrder(
        description=describe(opening.procedure.arm),
        channel=bus.channel,
        bitrate=bus.bitrate,
        record_to=record_to,
    )
    return OutsideArm(offer, order, f"the arm {bus.interface!r}")


def _recording_problem(path: Path | None, failure: str | None) -> str:
    remedy = "Free some space, or record to another disk"
    return f"the recording of the bus, {path}, ends early: {failure}. {remedy}" if failure else ""


def print_recording_problem(path: Path | None, failure: str | None) -> None:
    """Print why the recording of a bus to `path` ended early; nothing if there was no `failure`."""
    if problem := _recording_problem(path, failure):
        say(f"sarcal: {problem}.", err=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class CutShort:
    """A session that ended early.

    `connected`: whether an arm was connected. `kept`: whether the session folder still exists.
    """

    session: Session
    cause: BaseException
    connected: bool
    kept: bool


@contextmanager
def unattended(
    opening: Opening,
    *,
    record_to: Path | None = None,
    cut_short: Callable[[CutShort], None] = lambda _: None,
) -> Iterator[Session]:
    """Open a session for a command; however the session ends, hold the arm and close the journal.

    Calls `cut_short` if the session ends early. Removes the folder of a session that never connected.

    Raises `DrivesNotOffError` if the session has ended or was interrupted, and the arm did not confirm that it holds;
    `JournalLostError` if the session has ended, and its journal is lost.
    """
    with ending_signals_interrupt(), open_arm(opening, record_to=record_to) as rig:
        session = open_session(rig)
        reason, cause = "done", None
        try:
            yield session
        except BaseException as error:
            reason = "interrupted" if isinstance(error, KeyboardInterrupt) else "failed"
            cause = error
            raise
        finally:
            with ending_signals_ignored():
                # `identity` is set by this run only: an earlier run may have had another arm.
                connected = session.identity is not None
                session.close(reason)
                not_empty = not remove_if_empty(session)
            if cause is not None:
                cut_short(
                    CutShort(session=session, cause=cause, connected=connected, kept=not_empty)
                )
            if session.not_held is not None and isinstance(cause, KeyboardInterrupt | None):
                # An arm that may move is more important than the result.
                raise session.not_held from cause
        if session.journal.loss is not None:
            raise session.journal.loss


def _timing(procedure: Procedure, *, speed: float, embedded: bool) -> Timing:
    timing, profile = Timing(), procedure.profile
    if embedded:
        timing = Timing(
            speed=speed,
            heartbeat_timeout_s=EMBEDDED_TIMEOUT_S,
            lost_after_s=EMBEDDED_TIMEOUT_S,
            sdo_timeout_s=EMBEDDED_TIMEOUT_S,
        )
    elif profile.heartbeat_timeout_s is not None:
        timing = replace(timing, heartbeat_timeout_s=profile.heartbeat_timeout_s)
    sdo_timeout_s = procedure.bus.sdo_timeout_s or profile.sdo_timeout_s
    return timing if sdo_timeout_s is None else replace(timing, sdo_timeout_s=sdo_timeout_s)


def _completed(choices: Choices, bus: BusSettings, *, embedded: bool) -> Choices:
    if not embedded:
        return replace(choices, interface=bus.interface, channel=bus.channel, bitrate=bus.bitrate)
    chosen = choices.virtual_arm
    return replace(choices, interface="virtual", scenario=chosen.name, seed=chosen.seed)


def _instrument(
    procedure: Procedure, choices: Choices, controller: VirtualController | None
) -> Instrument | None:
    """Return the instrument named in the options, else the virtual arm's, else the procedure's, else None."""
    fixture = procedure.fixture.fixture
    if not isinstance(fixture, Measured):
        return None
    if choices.tracker is None and controller is not None and controller.tracker is not None:
        return virtual_instrument(controller.tracker, fixture)
    source = choices.tracker or procedure.tracker
    return None if source is None else Instrument(port_of(source), full_pose=fixture.full_pose)


def describe(arm: ArmModel) -> ArmDescription:
    """Return the description that the arm on the bus must match; raises SessionError if a joint has no sensor."""
    return ArmDescription(
        model=arm.name,
        joints=tuple(
            JointDescription(
                name=joint.name,
                lower_rad=joint.lower_rad,
                upper_rad=joint.upper_rad,
                max_speed_rad_per_s=joint.max_speed_rad_per_s,
                max_torque_nm=joint.max_torque_nm,
                sensor=_sensor(joint.name, joint.sensor),
            )
            for joint in arm.joints
        ),
    )


def _sensor(name: str, sensor: Encoder | Rvdt | NoSensor) -> EncoderDescription | RvdtDescription:
    match sensor:
        case Encoder():
            return EncoderDescription(counts_per_rev=sensor.counts_per_rev)
        case Rvdt():
            return RvdtDescription(bits=sensor.bits, full_scale_rad=sensor.full_scale_rad)
        case NoSensor():
            raise SessionError(
                f"joint {name} has no sensor",
                "a joint that is moved needs one; leave its reading out with --unsensed instead",
            )
