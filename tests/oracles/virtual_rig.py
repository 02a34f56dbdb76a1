"""A virtual controller on a bus inside this process, with a plant simple enough to predict."""

import itertools
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
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
    """Joint from -60 to 60 deg; the RVDT has 12 bits over 144 deg, 3 sigma inside its ends."""
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
    """Position joints are where they are told, free joints drift; torque and speed can be dictated."""

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
        for k, command in enumerate(commands):
            if command.mode is JointMode.POSITION and k + 1 not in self.stuck:
                self.angles_rad[k] = command.target_rad
            elif command.mode is JointMode.FREE:
                self.angles_rad[k] += self.drift_rad[k]
        return PlantReading(
            position_counts=tuple(
                round(angle * scale)
                for angle, scale in zip(self.angles_rad, self.scales, strict=True)
            ),
            torque_nm=tuple(self.torque_nm),
            speed_rad_per_s=tuple(self.speed_rad_per_s),
        )


class FakeClock:
    """Monotonic time that moves when told to."""

    def __init__(self) -> None:
        self.time_s = 1000.0

    def __call__(self) -> float:
        return self.time_s


class Rig:
    """Controller, plant, clock, and a raw peer on the same bus."""

    def __init__(
        self,
        controller: VirtualController,
        plant: Any,
        clock: FakeClock,
        peer: RawPeer,
        channel: str,
    ) -> None:
        self.controller, self.plant, self.clock, self.peer = controller, plant, clock, peer
        self.channel = channel

    def run_in_loop(self, reader: Callable[[], Any] = lambda: None) -> Any:
        """Run something in the control loop, after everything sent so far; return its result."""
        done = threading.Event()
        result: list[Any] = []

        def act() -> None:
            result.append(reader())
            done.set()

        # A frame that is answered, so that all earlier frames have been taken in.
        self.peer.read(16, 0x1000)
        self.controller.post(act)
        if not done.wait(5.0):
            raise TimeoutError("the control loop does not answer")
        return result[0]

    def advance_time(self, seconds: float) -> None:
        """Let time pass while the controller's loop listens: in steps too short to be its own lateness."""
        began_s, steps = self.clock.time_s, math.ceil(seconds / 0.09)
        for k in range(1, steps + 1):
            self.clock.time_s = began_s + seconds * k / steps
            self.run_in_loop()

    def inject_fault(self, kind: str, joint: int = 1) -> None:
        """Break something on purpose, and wait until it is so."""
        inject(self.controller, kind, joint)
        self.run_in_loop()

    def clear_disturbance(self, name: str, joint: int) -> None:
        """Undo what is kept of a joint in the disturbances."""
        kept = getattr(self.controller.disturbances, name)
        self.run_in_loop(lambda: kept.pop(joint) if isinstance(kept, dict) else kept.discard(joint))

    def set_drive_flag(self, joint: int, name: str, value: bool) -> None:
        """Set a flag of a drive."""
        self.run_in_loop(lambda: setattr(self.controller.drives[joint - 1].drive, name, value))

    def operational(self, modes: Sequence[int] = (8,) * 7) -> list[tuple[int, int, int]]:
        self.peer.start()
        self.peer.take_control()
        return self.peer.enable(list(modes))


def parse(document: bytes, of: Sequence[AxisSettings] | None = None) -> ValidatedParameters:
    """A tiny schema: serial number on the first line, one offset in counts a line after it."""
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
    """A running rig; `options` go to the controller. `plant` may be any other, with axes to fit."""
    channel = f"rig-{next(_channels)}"
    settings = axes()
    if plant is None:
        plant = TrivialPlant([a.scale.counts_per_rad for a in settings])
    clock = FakeClock()
    with (
        can.Bus(channel, interface="virtual", receive_own_messages=False) as near,
        can.Bus(channel, interface="virtual", receive_own_messages=False) as far,
    ):
        controller = VirtualController(
            far,
            plant,
            **{"axes": settings, "arm": ARM, "validate": parse, "clock": clock, **options},
        )
        with controller:
            yield Rig(controller, plant, clock, RawPeer(near), channel)
