"""Builds and runs the virtual arm: scenario, controller, parameter slots, tracker."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from fixtures.measured import Measured
from hardware.buses.python_can import BusSettings, open_bus
from hardware.canopen.objects import HEARTBEAT_TIMEOUT_S, Slot
from hardware.line_port import CalledLines
from hardware.virtual.axis import arm_axes
from hardware.virtual.controller import VirtualController
from hardware.virtual.embedded_bus import EmbeddedBus
from hardware.virtual.faults import ScriptedFault
from hardware.virtual.parameter_store import FolderDisk, ParameterStore, ValidatedParameters
from hardware.virtual.scenarios import Scenario, scenario_of
from hardware.virtual.supervisor_node import ArmLabel
from hardware.virtual.tracker import SimulatedTracker
from operator_app.config.errors import ConfigError
from operator_app.config.fixture_file import FixtureSpec
from operator_app.config.parameters_file import parse_parameters
from operator_app.errors import SessionError
from operator_app.session.workflow.opening import Choices
from operator_app.session.workflow.pose_reading import Instrument
from solver.chain.arm_model import ArmModel

SERIAL_NUMBER = "SDA-0001"
"""Serial number of every virtual arm."""


def virtual_arm(
    arm: ArmModel, fixture: FixtureSpec, choices: Choices, placement: int = 1
) -> Scenario:
    """Return a virtual arm in placement number `placement` of a fixture; raises SessionError if it cannot be built."""
    named = choices.virtual_arm
    try:
        return scenario_of(named.name, named.seed, arm, fixture.fixture, placement)
    except ValueError as error:
        raise SessionError(
            f"no virtual arm can be built from {arm.name} in {fixture.name}: {error}",
            "correct these files, or connect a real bus with -i",
        ) from error


def true_values(
    arm: ArmModel, fixture: FixtureSpec, choices: Choices, placement: int
) -> Mapping[str, float]:
    """Return the true parameters (rad, m) of `virtual_arm` by name; they are never sent over a bus."""
    return virtual_arm(arm, fixture, choices, placement).true_loop().named()


@contextmanager
def run_controller(
    arm: ArmModel,
    choices: Choices,
    settings: BusSettings,
    *,
    fixture: FixtureSpec,
    placement: int = 1,
    slots: Path | None = None,
    heartbeat_timeout_s: float = HEARTBEAT_TIMEOUT_S,
    script: Sequence[ScriptedFault] = (),
    attended: bool = False,
) -> Iterator[VirtualController]:
    """Start the virtual controller of an arm on a bus, yield the controller, and close it at the end.

    The simulated arm is `arm` in `fixture` at `placement`. `slots`: folder of the parameter slots; None: in memory.
    `script`: faults to inject. `attended`: whether the operator is in this process and, while waiting for frames, calls
    `VirtualController.attend`. Raises SessionError if the arm cannot be built or the slots cannot be read.
    """
    chosen = virtual_arm(arm, fixture, choices, placement)
    carried = chosen.arm(arm)
    try:
        plant, axes = chosen.build(arm), arm_axes(carried)
    except ValueError as error:
        raise SessionError(
            f"no virtual arm can be built from {arm.name}: {error}",
            "correct its file, or connect a real bus with -i",
        ) from error
    store = slots_in(slots)
    bus = EmbeddedBus(settings.channel) if attended else open_bus(settings)
    controller = VirtualController(
        bus,
        plant,
        axes=axes,
        arm=ArmLabel(model=arm.name, serial_number=SERIAL_NUMBER),
        validate=validated_parameters,
        store=store,
        heartbeat_timeout_s=heartbeat_timeout_s,
        script=script,
        attended=attended,
    )
    if isinstance(fixture.fixture, Measured):
        controller.tracker = chosen.tracker(plant, fixture.fixture)
    controller.start()
    try:
        yield controller
    finally:
        controller.close()
        bus.shutdown()


def slots_in(folder: Path | None) -> ParameterStore:
    """Return the parameter slots in `folder` (None: in memory); raises SessionError if the slots cannot be used."""
    if folder is None:
        return ParameterStore()
    try:
        store = ParameterStore(FolderDisk(folder))
        for slot in (Slot.A, Slot.B):
            store.state(slot)
        _ = store.active
    except (OSError, ValueError) as error:
        raise SessionError(
            f"parameters cannot be stored in {folder} ({error})",
            "name a writable folder, or leave --state out to keep them in memory",
        ) from error
    return store


def virtual_instrument(tracker: SimulatedTracker, fixture: Measured) -> Instrument:
    """Return the tracker of this process's virtual arm as an `Instrument`."""
    port = CalledLines(tracker.answer, "the virtual arm's tracker")
    return Instrument(port, full_pose=fixture.full_pose)


def validated_parameters(data: bytes) -> ValidatedParameters:
    """Return what the virtual supervisor needs of a parameters document; raises ValueError if it is invalid."""
    try:
        document = parse_parameters(data)
    except ConfigError as error:
        raise ValueError(str(error)) from error
    counts = [joint.home_offset_counts for joint in document.joints]
    return ValidatedParameters(
        arm_serial=document.arm.serial,
        home_offset_counts=tuple(0 if c is None else c for c in counts),
        theta_off_rad=tuple(document.theta_off_rad.tolist()),
    )
