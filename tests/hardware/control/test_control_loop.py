"""Ctrl-C at any point of a wait in the caller's thread never blocks the thread that receives and controls."""

import gc
import itertools
import sys
import threading
from collections.abc import Callable

import pytest

from hardware.canopen.sdo import ObjectAccess
from hardware.control import control_loop, motion_steps
from hardware.control.control_loop import LoopTask, Steps
from hardware.errors import HardwareError
from tests.hardware.control.canopen_arm.conftest import make
from tests.hardware.fake_arm import FakeArmBus


@pytest.fixture(autouse=True)
def uncollected():
    """Without garbage collection: an interrupt would hit the `__del__` of an object of an earlier test."""
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def interrupted_at(opcode: int, work: Callable[[], object]) -> bool:
    """Run `work`, and raise KeyboardInterrupt before its n-th opcode; whether `work` had so many."""
    left = opcode

    def trace(frame, event, _argument):
        nonlocal left
        if frame.f_globals.get("__name__") == "logging":
            return None  # pytest's log handler would stay locked, for all later tests
        frame.f_trace_opcodes = True
        if event == "opcode":
            left -= 1
            if left == 0:
                raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        work()
    except (KeyboardInterrupt, HardwareError):
        pass
    finally:
        sys.settrace(before)
    return left <= 0


def ends(work: Callable[[], object]) -> bool:
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(20.0)
    return not thread.is_alive()


def ended() -> bool:
    return False


def test_interrupted_wait_for_a_task_does_not_block_its_end(monkeypatch):
    monkeypatch.setattr(control_loop, "_ALIVE_POLL_S", 1e-3)
    for opcode in itertools.count(1):
        task = LoopTask(_ for _ in ())
        if not interrupted_at(opcode, lambda task=task: task.wait(ended)):  # after one poll
            break
        assert ends(lambda task=task: task.finish(result=1)), opcode
        assert task.wait(ended)
    assert opcode > 20


def test_interrupted_command_ends_at_rest_and_the_connection_stays(monkeypatch):
    monkeypatch.setattr(control_loop, "_ALIVE_POLL_S", 1e-4)
    bus = FakeArmBus()
    arm = make(bus)
    arm.connect()
    loop = arm._link.loop

    def steps() -> Steps[None]:
        while loop.alarm() is None:
            yield None

    try:
        for opcode in range(1, 200):
            assert interrupted_at(opcode, lambda: loop.run(steps()))
            assert not loop._tasks, opcode
        assert loop.run(motion_steps.capture(arm._link, 1)).samples == 1
    finally:
        arm.close()


def test_interrupted_sdo_access_does_not_block_the_next_answer():
    for opcode in itertools.count(1, 3):
        access = ObjectAccess(lambda *_: None, [1], timeout_s=1e-3)
        access.deliver(0x581, bytes(8))  # the client discards an old answer first
        if not interrupted_at(opcode, lambda access=access: access.read_once(1, 0x1000)):
            break
        assert ends(lambda access=access: access.deliver(0x581, bytes(8))), opcode
    assert opcode > 100
