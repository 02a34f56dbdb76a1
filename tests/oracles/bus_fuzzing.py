"""Bus fuzzing of a connected operator: CAN frames inserted, dropped, changed, repeated and delayed, by seed.

The man in the middle shares nothing with `hardware`: it uses numbers of the standards, and recorded frames. The
virtual arm has no errors and does not move, so that readings can be compared with the drives' counts. A wrong reading
that is accepted, an exception other than `HardwareError`, a failed thread: each is a defect and is raised.
"""

import itertools
import os
import threading
from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from random import Random
from typing import Any

import can
import numpy as np

from hardware.arm import JointMode
from hardware.buses.python_can import BusSettings, open_bus
from hardware.control.canopen_arm import CanopenArm
from hardware.errors import HardwareError
from hardware.virtual.scenarios import scenario
from operator_app.config.procedure_file import load_procedure
from operator_app.session.workflow.opening import Choices
from operator_app.virtual_arms import run_controller
from tests.oracles.fast_arm import fast_arm

NODES = (*range(1, 8), 16)
BASES = (0x000, 0x080, 0x180, 0x200, 0x280, 0x580, 0x600, 0x700, 0x7E4)
SDO_BYTES = bytes.fromhex("0001102040414243474B4F607080A2C1FF")
MAX_COUNT_ERROR = 3.0
"""Largest difference of a mean reading from the drives' counts."""
MODES = [JointMode.POSITION if j in (1, 5) else JointMode.FREE for j in range(1, 8)]
Plan = Sequence[tuple[int, str]]
"""Numbers of frames to pass, each with the name of the following action."""
_channels = itertools.count()


class FrameMutator:
    """Replaces the operator's bus handle, and applies the actions of `todo` to received frames."""

    bus: can.BusABC | None = None

    def __init__(self, rng: Random, plan: Plan) -> None:
        self._waiting: deque[can.Message] = deque()
        self._seen: deque[can.Message] = deque(maxlen=200)
        self.begin(rng, plan)

    def begin(self, rng: Random, plan: Plan) -> None:
        self.rng, self.todo = rng, deque(plan)
        self._delayed: list[tuple[int, can.Message]] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self.bus, name)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if not self._waiting:
            message = self.bus.recv(timeout)
            if message is None:
                return None
            self._seen.append(message)
            self._waiting.extend(self._changed(message))
            self._waiting.extend(delayed for due, delayed in self._delayed if due == 0)
            self._delayed = [(due - 1, delayed) for due, delayed in self._delayed if due > 0]
        return self._waiting.popleft() if self._waiting else None

    def _changed(self, message: can.Message) -> list[can.Message]:
        """Return the frames in place of a received one, by the action that is due."""
        if not self.todo:
            return [message]
        after, action = self.todo.popleft()
        if after > 0 or (action == "other answer" and message.arbitration_id & 0x780 != 0x580):
            self.todo.appendleft((max(after - 1, 0), action))
            return [message]
        rng, data = self.rng, bytes(message.data)
        match action:
            case "insert":
                frames = [self._foreign() for _ in range(rng.choice((1, 1, 1, 5, 50, 300)))]
                return [message, *frames] if rng.random() < 0.5 else [*frames, message]
            case "other length":
                longer = data + rng.randbytes(8) if rng.random() < 0.3 else data
                other = longer[: rng.randrange(9)]
                return [
                    _frame(message.arbitration_id, other if len(other) != len(data) else data[:-1])
                ]
            case "repeat":
                return [message] * rng.choice((2, 3, 40))
            case "again":
                return [message, rng.choice(self._seen)]
            case "delay":
                self._delayed.append((rng.choice((1, 2, 8, 15)), message))
            case "other answer":
                return [_frame(message.arbitration_id, self._other_answer(data))]
        return []  # delayed or dropped

    def _other_answer(self, answer: bytes) -> bytes:
        rng, data = self.rng, bytearray(answer)
        for _ in range(rng.choice((1, 1, 2))):
            match rng.randrange(4):
                case 0:
                    data[0] = rng.choice(SDO_BYTES)
                case 1:
                    data[rng.randrange(8)] ^= 1 << rng.randrange(8)
                case 2:
                    data[4:8] = rng.choice((b"\0\0\0\0", b"\xff\xff\xff\xff", rng.randbytes(4)))
                case _:
                    data = bytearray(rng.randbytes(8))
        return bytes(data)

    def _foreign(self) -> can.Message:
        """A frame that no node of this bus has sent."""
        rng = self.rng
        node, some = rng.choice((*NODES, 0, 9, 30, 100, 127)), rng.randbytes(rng.randrange(9))
        identifier = rng.choice(BASES) + node & 0x7FF
        match rng.randrange(9):
            case 0:
                return _frame(rng.randrange(0x800), some)
            case 1:
                return _frame(rng.randrange(1 << 29), some, is_extended_id=True)
            case 2:
                return _frame(identifier, None, is_remote_frame=True, dlc=rng.randrange(9))
            case 3:
                return _frame(0, rng.randbytes(8), is_error_frame=True, is_extended_id=True)
            case 4:  # heartbeats and boot-ups
                state = rng.choice((0, 4, 5, 127, 128, 133, 255))
                return _frame(0x700 + node, bytes([state]) * rng.choice((0, 1, 1, 1, 2)))
            case 5:  # emergencies
                code = rng.choice((0, 0x8130, 0x8611, 0x5441, 0xFFFF, rng.randrange(1 << 16)))
                emergency = code.to_bytes(2, "little") + rng.randbytes(6)
                return _frame(0x080 + node, emergency[: rng.choice((8, 8, 8, 1, 2, 3))])
            case 6:
                return _frame(0x580 + node, bytes([rng.choice(SDO_BYTES)]) + rng.randbytes(7))
            case 7 if self._seen:
                earlier_frame = rng.choice(self._seen)
                data = bytearray(earlier_frame.data)
                if data and rng.random() < 0.7:
                    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
                return _frame(earlier_frame.arbitration_id, bytes(data))
            case _:
                return _frame(identifier, some)


def _frame(identifier: int, data: bytes | None, **options: Any) -> can.Message:
    return can.Message(arbitration_id=identifier, data=data, **{"is_extended_id": False, **options})


def _take_control(arm: CanopenArm) -> None:
    arm.take_control()
    arm.set_modes(MODES)


class FuzzedOperator:
    """An operator in control of a still arm, replaced after each input that ended it."""

    def __init__(self) -> None:
        self._stack = ExitStack()
        self._failures: list[BaseException] = []
        self.arm: CanopenArm | None = None

    def close(self) -> None:
        self.arm = None
        self._stack.close()

    def _open(self, rng: Random, plan: Plan) -> CanopenArm:
        procedure = load_procedure("hinge")
        arm_file = scenario("exact").arm(procedure.arm)
        settings = BusSettings(channel=f"wire-{os.getpid()}-{next(_channels)}")
        self._controller = self._stack.enter_context(
            run_controller(
                arm_file,
                Choices(scenario="exact"),
                settings,
                fixture=procedure.fixture,
                heartbeat_timeout_s=30.0,
            )
        )
        self.mutator = FrameMutator(rng, plan)

        def open_main(bus_settings: BusSettings) -> Any:
            self.mutator.bus = open_bus(bus_settings)
            return self.mutator

        waits = {"patience_s": 5.0, "lost_after_s": 0.2, "answers_s": 0.05, "sdo_timeout_s": 0.05}
        self.arm = fast_arm(arm_file, settings, open_main=open_main, **waits)
        self._stack.callback(self.arm.close)
        return self.arm

    def fuzz(self, rng: Random) -> None:
        """Apply one fuzzed input while the operator performs a task; raises the resulting error."""
        threading.excepthook = lambda args: self._failures.append(args.exc_value or RuntimeError())
        connecting, plan = rng.random() < 0.02, self._plan(rng)
        if connecting:
            self.close()
        if (arm := self.arm) is None:
            arm = self._open(rng, plan if connecting else ())
            if not connecting:
                arm.connect()
                _take_control(arm)
                arm.settle(window=5, spread_rad=[1e-4] * 7, timeout_syncs=500)
        try:
            if connecting:
                arm.connect()
                _take_control(arm)
            else:
                self.mutator.begin(rng, plan)
                self._work(arm, rng)
        except HardwareError:
            self._recover(arm)
            raise
        finally:
            self.mutator.todo.clear()
            self._raise_failures()

    def _plan(self, rng: Random) -> Plan:
        kinds = (
            ("insert", "insert", "insert", "again"),
            ("insert", "other answer"),
            ("other answer",),
            ("drop", "other length", "repeat", "delay"),
        )
        names = rng.choice(kinds)
        return [(rng.randrange(20), rng.choice(names)) for _ in range(rng.choice((1, 1, 2, 4)))]

    def _work(self, arm: CanopenArm, rng: Random) -> None:
        for _ in range(rng.choice((1, 2))):
            match rng.randrange(8):
                case 0 | 1 | 2:
                    self._read(arm, rng.choice((1, 2, 4)))
                case 3:
                    arm.settle(window=3, spread_rad=[1e-4] * 7, timeout_syncs=20)
                case 4:
                    arm.active_parameters()
                case 5:
                    arm.set_modes(MODES)
                case 6:
                    position_rad = arm.snapshot().positions_rad
                    arm.move({1: float(position_rad[0]) + 0.001}, speed_rad_per_s=0.1)
                    arm.settle(window=5, spread_rad=[1e-4] * 7, timeout_syncs=500)
                case _:
                    arm.upload_parameters(b"schema: sarcal/parameters/2\n" * rng.choice((1, 9, 40)))

    def _read(self, arm: CanopenArm, samples: int) -> None:
        before = self._counts()
        reading = arm.capture(samples)
        # An earlier move may not have settled.
        counts = np.array([before, self._counts()])
        low, high = counts.min(axis=0) - MAX_COUNT_ERROR, counts.max(axis=0) + MAX_COUNT_ERROR
        if np.any((reading.mean_counts < low) | (reading.mean_counts > high)):
            raise AssertionError(f"{reading.mean_counts} instead of {counts}")

    def _counts(self) -> list[int]:
        return [node.drive.counts for node in self._controller.drives]

    def _recover(self, arm: CanopenArm) -> None:
        self.mutator.todo.clear()
        try:
            arm.reset_stop()
            _take_control(arm)
        except HardwareError:
            self.close()

    def _raise_failures(self) -> None:
        """Raise exceptions of threads, and disconnect."""
        failure = self._controller.failure
        if failure is not None or self._failures:
            failures, self._failures = self._failures, []
            with suppress(HardwareError):
                self.close()
            raise AssertionError(f"{failure!r} {failures!r}") from (failure or failures[0])
