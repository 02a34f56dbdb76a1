"""A virtual controller on a bus inside this process, with a trivial plant."""

import itertools
import math
import queue
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import can

from hardware.arm import JointMode
from hardware.virtual.axis import AxisSettings, JointCommand, PlantReading
from hardware.virtual.controller import VirtualController
from hardware.virtual.faults import inject
from hardware.virtual.parameter_store import ValidatedParameters
from hardware.virtual.supervisor_node import ArmLabel
from solver.chain.arm_model import Joint
from solver.chain.sensors import Encoder, Rvdt
from tests.oracles.raw_can import RawPeer

ARM = ArmLabel(model="test_arm", serial_number="SDA-0007")
COUNTS_PER_REV = 36_000  # 100 counts a degree
_channels = itertools.count()


def joint(*, rvdt: bool = False) -> Joint:
    """Joint from -60 to 60 deg; the RVDT has 12 bits over 144 deg."""
    return Joint(
        name="test",
        lower_rad=math.radians(-60.0),
        upper_rad=math.radians(60.0),
        sensor=Rvdt(bits=12, full_scale_rad=math.radians(144.0), linearity=0.0, noise_lsb=0.0)
        if rvdt
        else Encoder(counts_per_rev=COUNTS_PER_REV),
        max_speed_rad_per_s=math.radians(180.0),
        max_torque_nm=100.0,
    )


def axes() -> tuple[AxisSettings, ...]:
    return tuple(AxisSettings(j, joint(rvdt=j >= 6)) for j in range(1, 8))


class TrivialPlant:
    """Position joints are at their targets, free joints drift; torque and speed can be set."""

    def __init__(self, scales: Sequence[float]) -> None:
        self.joint_count = len(scales)
        self.scales = scales
        self.angles_rad = [0.01 * (j + 1) for j in range(self.joint_count)]
        self.drift_rad = [0.0] * self.joint_count
        self.torque_nm = [0.0] * self.joint_count
        self.speed_rad_per_s = [0.0] * self.joint_count
        self.stuck: set[int] = set()
        self.commands: list[JointCommand] = []
        self.steps = 0

    def step(self, commands: Sequence[JointCommand]) -> PlantReading:
        self.steps += 1
        self.commands = list(commands)
        for k, (mode, target_rad) in enumerate(commands):
            if mode is JointMode.POSITION and k + 1 not in self.stuck:
                self.angles_rad[k] = target_rad
            elif mode is JointMode.FREE:
                self.angles_rad[k] += self.drift_rad[k]
        angles = zip(self.angles_rad, self.scales, strict=True)
        counts = tuple(round(angle * scale) for angle, scale in angles)
        return PlantReading(counts, tuple(self.torque_nm), tuple(self.speed_rad_per_s))


class FakeClock:
    def __init__(self) -> None:
        self.time_s = 1000.0

    def __call__(self) -> float:
        return self.time_s


@dataclass(eq=False)
class Rig:
    """Controller, plant, clock, and a raw peer on the same bus."""

    controller: VirtualController
    plant: Any
    clock: FakeClock
    peer: RawPeer
    channel: str

    def run_in_loop(self, reader: Callable[[], Any] = lambda: None) -> Any:
        """Return the result of a function that runs in the control loop, after all frames sent so far."""
        results: queue.SimpleQueue[Any] = queue.SimpleQueue()
        # The response comes after all earlier frames.
        self.peer.read(16, 0x1000)
        self.controller.post(lambda: results.put(reader()))
        return results.get(timeout=60.0)

    def advance_time(self, seconds: float) -> None:
        """Advance the clock, in steps that are too short to count as lateness of the control loop."""
        began_s, steps = self.clock.time_s, math.ceil(seconds / 0.09)
        for k in range(1, steps + 1):
            self.clock.time_s = began_s + seconds * k / steps
            self.run_in_loop()

    def inject_fault(self, kind: str, joint: int = 1) -> None:
        """Inject a fault, and wait until the control loop has applied it."""
        inject(self.controller, kind, joint)
        self.run_in_loop()

    def clear_fault(self, kind: str, joint: int) -> None:
        self.run_in_loop(lambda: self.controller.drives[joint - 1].faults.remove(kind))

    def operational(self, modes: Sequence[int] = (8,) * 7) -> list[tuple[int, int, int]]:
        self.peer.start()
        self.peer.take_control()
        return self.peer.enable(list(modes))


def parse(document: bytes, of: Sequence[AxisSettings] | None = None) -> ValidatedParameters:
    """A minimal document: the serial number, then one offset in counts a line."""
    try:
        serial, *offsets = document.decode().split()
        counts = tuple(int(text) for text in offsets)
    except ValueError as error:
        raise ValueError(f"not a parameter document: {error}") from error
    scales = [settings.scale.counts_per_rad for settings in of or axes()]
    return ValidatedParameters(
        arm_serial=serial,
        home_offset_counts=counts,
        theta_off_rad=tuple(count / scale for count, scale in zip(counts, scales, strict=False)),
    )


@contextmanager
def rig(*, plant: Any = None, **options: Any) -> Iterator[Rig]:
    """A running rig, by default with a `TrivialPlant`; `options` are the controller's."""
    channel = f"rig-{next(_channels)}"
    settings = axes()
    if plant is None:
        plant = TrivialPlant([a.scale.counts_per_rad for a in settings])
    clock = FakeClock()
    with (
        can.Bus(channel, interface="virtual", receive_own_messages=False) as operator_bus,
        can.Bus(channel, interface="virtual", receive_own_messages=False) as controller_bus,
    ):
        controller = VirtualController(
            controller_bus,
            plant,
            **{"axes": settings, "arm": ARM, "validate": parse, "clock": clock, **options},
        )
        with controller:
            yield Rig(controller, plant, clock, RawPeer(operator_bus), channel)
