"""A virtual controller whose nodes are told what nobody would tell them: frames odd and malformed, seed by seed.

Shares nothing with `hardware` but what runs the controller; numbers are the standards'. After every input
the control loop still lives, every node answers a read of 1000h, and a quick stop to all drives is obeyed:
none is enabled, no joint moves. What is not so is a defect and is raised.
"""

from __future__ import annotations

import itertools
import os
import threading
import time
from contextlib import ExitStack
from random import Random

import can
import numpy as np

from hardware.arm import DriveState
from hardware.buses.python_can import BusSettings, open_bus
from hardware.virtual.drive import Drive
from hardware.virtual.plant import Plant
from hardware.virtual.scenarios import scenario
from operator_app.config.procedure_file import load_procedure
from operator_app.session.workflow.opening import Choices
from operator_app.virtual_arms import run_controller
from tests.oracles.raw_can import RawAbort, RawPeer
from tests.oracles.wire_fuzzing import NODES, SDO_BYTES, FellOverError

MODES = [8, 10, 10, 10, 8, 10, 10]
OBJECTS = (0x1000, 0x1001, 0x1003, 0x1016, 0x1017, 0x1A00, 0x6040, 0x6060, 0x607A, 0x607C,
           0x2000, 0x2001, 0x2002, 0x2003, 0x2010, 0x0000, 0xFFFF)  # fmt: skip
CONTROLWORDS = (0x00, 0x02, 0x06, 0x07, 0x0F, 0x1F, 0x80, 0xFF, 0xFFFF)
HELD_DEG = 0.05
"""What servo and fixture give."""
PATIENCE_S = 10.0
_channels = itertools.count()


class NotStoppedError(AssertionError):
    """A drive went on, or a node said nothing any more."""


class ControllerTarget:
    """A controller with its drives enabled, made anew whenever an input has ended that."""

    def __init__(self) -> None:
        self._stack = ExitStack()
        self._fallen: list[BaseException] = []
        self._peer: RawPeer | None = None

    def close(self) -> None:
        self._peer = None
        self._stack.close()

    def _open(self) -> RawPeer:
        arm_file = scenario("exact").arm(load_procedure("hinge").arm)
        settings = BusSettings(channel=f"told-{os.getpid()}-{next(_channels)}")
        self._controller = self._stack.enter_context(
            run_controller(arm_file, Choices(scenario="exact"), settings, heartbeat_timeout_s=60.0)
        )
        self._bus = open_bus(settings)
        self._stack.callback(self._bus.shutdown)
        self._peer = RawPeer(self._bus)
        return self._peer

    def drive(self, joint: int) -> Drive:
        """One of the drives, for who wants to break it."""
        return self._controller.drives[joint - 1].drive

    def ready(self) -> RawPeer:
        """Return a peer in control of an arm whose drives are enabled; anew if they will not be."""
        if self._peer is not None:
            peer = self._peer
            peer.log.clear()
            try:
                peer.start()
                self._taken_in()
                for joint in range(1, 8):
                    peer.command(joint, 0x00, 0, 8)
                    peer.command(joint, 0x80, 0, 8)
                peer.take_control()
                peer.enable(MODES)
            except (RawAbort, AssertionError, TimeoutError):
                self.close()
            else:
                if self._enabled():
                    return peer
                self.close()
        peer = self._open()
        peer.start()
        peer.take_control()
        peer.enable(MODES)
        assert self._enabled()
        return peer

    def tell(self, rng: Random) -> bool:
        """Say one input's frames to the nodes, then stop them; whether a node refused in so many words."""
        threading.excepthook = lambda seen: self._fallen.append(seen.exc_value or RuntimeError())
        peer = self.ready()
        peer.log.clear()
        for _ in range(rng.choice((1, 1, 2, 5, 30, 300))):
            self._bus.send(self._frame(rng))
        self._taken_in()
        self._look()
        refused = any(0x580 < n < 0x600 and data[0] == 0x80 for n, data in peer.log)
        self.require_stop(peer)
        self._require_answers(peer)
        self._look()
        return refused

    # ---- what is said ----------------------------------------------------------------------------------

    def _frame(self, rng: Random) -> can.Message:
        node = rng.choice((*NODES, 0, 9, 100, 127))
        match rng.randrange(10):
            case 0:  # NMT, commands and lengths that there are not
                data = bytes([rng.choice((0, 1, 2, 128, 129, 130, 255)), node])
                return _message(
                    0x000, (data + rng.randbytes(6))[: rng.choice((0, 1, 2, 2, 2, 3, 8))]
                )
            case 1:  # RPDOs of every length
                return _message(0x200 + node, rng.randbytes(rng.randrange(9)))
            case 2:  # and those that look sound
                word, mode = rng.choice(CONTROLWORDS), rng.choice((-128, -1, 0, 1, 8, 10, 127))
                target = rng.choice((0, -(2**31), 2**31 - 1, rng.randrange(-(2**19), 2**19)))
                data = word.to_bytes(2, "little") + target.to_bytes(4, "little", signed=True)
                return _message(0x200 + node, data + mode.to_bytes(1, "little", signed=True))
            case (
                3 | 4
            ):  # object access, the begin of a transfer or the middle of one that nobody began
                index, sub = rng.choice(OBJECTS), rng.choice((0, 0, 1, 2, 3, 255))
                head = bytes([rng.choice(SDO_BYTES)]) + index.to_bytes(2, "little") + bytes([sub])
                rest = rng.choice((bytes(4), b"\xff" * 4, rng.randbytes(4)))
                return _message(
                    0x600 + node, (head + rest)[: rng.choice((8, 8, 8, rng.randrange(8)))]
                )
            case 5:
                return _message(0x600 + node, bytes([rng.randrange(256)]) + rng.randbytes(7))
            case 6:
                return _message(0x080, rng.randbytes(rng.choice((0, 0, 1, 8))))
            case 7:  # heartbeats of anybody
                return _message(0x700 + node, rng.randbytes(rng.choice((0, 1, 1, 8))))
            case 8:
                return can.Message(
                    arbitration_id=rng.choice((0x000, 0x080, 0x200 + node, 0x600 + node)),
                    is_extended_id=rng.random() < 0.5, is_remote_frame=True, dlc=rng.randrange(9),
                )  # fmt: skip
            case _:
                return _message(rng.randrange(0x800), rng.randbytes(rng.randrange(9)))

    # ---- what is looked at -----------------------------------------------------------------------------

    def require_stop(self, peer: RawPeer) -> None:
        for joint in range(1, 8):
            peer.command(joint, 0x02, 0, 8)
        self._taken_in()
        peer.send(0x080)
        self._taken_in()
        if self._enabled():
            raise NotStoppedError(f"joints {self._enabled()} stay enabled after a quick stop")
        begun = self._angles_deg()
        for _ in range(20):
            peer.send(0x080)
        self._taken_in()
        moved = float(np.abs(self._angles_deg() - begun).max())
        if moved > HELD_DEG:
            raise NotStoppedError(f"a joint went {moved:.3f} deg after a quick stop")

    def _require_answers(self, peer: RawPeer) -> None:
        peer.start()
        for node in NODES:
            peer.log.clear()
            peer.send(0x600 + node, b"\x40\x00\x10\x00\x00\x00\x00\x00")
            # A transfer that was begun before may be answered in between.
            peer.wait_for(
                lambda n, data, node=node: n == 0x580 + node and data[:4] == b"\x43\x00\x10\x00"
            )

    def _enabled(self) -> list[int]:
        return [
            node.number
            for node in self._controller.drives
            if node.drive.state is DriveState.OPERATION_ENABLED
        ]

    def _angles_deg(self) -> np.ndarray:
        plant = self._controller.plant
        assert isinstance(plant, Plant)
        return np.rad2deg(plant.true_angles_rad)

    def _taken_in(self) -> None:
        """Wait until the control loop has seen to all that was sent; takes in what it answered."""
        until_s = time.monotonic() + PATIENCE_S
        peer = self._peer
        assert peer is not None
        while time.monotonic() < until_s:
            self._look()
            peer.quiet()
            waits = self._controller._bus.queue.empty()  # type: ignore[attr-defined]
            for _ in range(2):
                done = threading.Event()
                self._controller.post(done.set)
                done.wait(1.0)
            if waits:
                peer.quiet()
                return
        raise NotStoppedError("the control loop does not come to an end of what it was sent")

    def _look(self) -> None:
        failure = self._controller.failure
        if failure is not None or self._fallen:
            fallen, self._fallen = self._fallen, []
            self.close()
            raise FellOverError(f"{failure!r} {fallen!r}") from (failure or fallen[0])


def _message(identifier: int, data: bytes) -> can.Message:
    return can.Message(arbitration_id=identifier & 0x7FF, data=data, is_extended_id=False)
