"""The virtual controller: drive nodes and supervisor, one control loop, one plant step per SYNC.

One thread receives, steps the plant, answers, monitors the operator's heartbeat and sends the nodes' heartbeats, which
stop if this thread hangs. A second thread checks parameter documents and writes them to disk.

If operator and arm are in one process, the operator's thread handles the frames while it waits for an answer
(`VirtualController.attend`), which halves the time per frame. The heartbeat of an operator with the control token is
monitored; when the heartbeat is lost, all drives hold and raise 8130h, and the token lapses.
"""

import math
import queue
import struct
import threading
import time
from collections.abc import Callable, Sequence
from typing import Self

import can
from canopen.sdo import constants as sdo

from hardware.buses.acceptance_filters import controller_filters, set_hardware_filters
from hardware.canopen import objects
from hardware.canopen.objects import HEARTBEAT_PERIOD_S, HEARTBEAT_TIMEOUT_S, NmtCommand
from hardware.timing import LatencyMonitor, raise_loop_priority
from hardware.virtual.axis import AxisSettings
from hardware.virtual.disturbances import FaultyWire
from hardware.virtual.drive_node import DriveGroup, DriveNode
from hardware.virtual.faults import ScriptedFault, inject
from hardware.virtual.node import VirtualNode
from hardware.virtual.parameter_store import ParameterStore, Validate
from hardware.virtual.plant import Plant
from hardware.virtual.supervisor_node import ArmLabel, SupervisorNode
from hardware.virtual.tracker import SimulatedTracker

_POLL_S = 0.02
"""Longest wait for a frame, after which timed duties and posted actions are handled."""
_SHORT_POLL_S = 0.002
"""Longest wait for a frame while frames are delayed by a fault."""
_CATCH_UP_FRAMES = 1000
"""Number of queued frames handled before a heartbeat counts as lost: the heartbeat may be behind them."""
STORM = 50
"""Number of emergencies sent on every SYNC in an emergency storm."""
_NODE_BITS = 0x7F
_SDO_REFUSAL = struct.Struct("<B3sI")
_STORM_EMERGENCY = objects.EMCY.pack(0x1000, objects.ErrorBit.GENERIC, bytes(5))


class VirtualController:
    """Simulated controller on one bus: a drive node for each of `axes`, and a supervisor.

    `bus` must be open; the controller sets its filters, but does not close it. `hardware.virtual.axis.arm_axes` makes
    `axes`. By default `store` is in memory. `heartbeat_timeout_s`: time without a heartbeat after which the operator
    counts as lost. `attended`: the operator is in this process and calls `attend` while it waits for frames.
    """

    def __init__(
        self,
        bus: can.BusABC,
        plant: Plant,
        *,
        axes: Sequence[AxisSettings],
        arm: ArmLabel,
        validate: Validate,
        store: ParameterStore | None = None,
        heartbeat_timeout_s: float = HEARTBEAT_TIMEOUT_S,
        clock: Callable[[], float] = time.monotonic,
        script: Sequence[ScriptedFault] = (),
        attended: bool = False,
    ) -> None:
        self._bus, self.now_s = bus, clock
        self._attended = attended
        self._timeout_s = heartbeat_timeout_s
        self._script = sorted(script, key=lambda fault: fault.at_sync, reverse=True)
        self.wire_out = self.wire_in = FaultyWire()
        """Directions from and to the arm, with their faults."""
        self.cut_since_s: dict[int, float] = {}
        """Time at which a node's cable was cut (clock `now_s`), by node."""
        self.off_until_s: float | None = None
        """Time until which no frame passes (clock `now_s`); None if frames pass."""
        self.sync_count = 0
        """SYNCs answered so far."""
        self.tracker: SimulatedTracker | None = None
        """Tracker that measures an open arm; it is not on the bus. None for an arm in a fixture."""
        self.failure: Exception | None = None
        """Error that ended the control loop; None if there is none. The context manager raises it on exit."""
        self._latency = LatencyMonitor(clock)
        self._heard_s: dict[int, float] = {}
        self._posted: queue.SimpleQueue[Callable[[], object]] = queue.SimpleQueue()
        self._work: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._closing = False
        self._turns = threading.Lock()
        self._in_turn: int | None = None
        self.running: threading.Event = threading.Event()
        """The control loop hangs while this event is not set."""
        self.running.set()
        serial = arm.number % 1_000_000 * 100
        self._send_lock = threading.Lock()
        self.drives: tuple[DriveNode, ...] = tuple(
            DriveNode(axis, self._send, serial_number=serial + axis.joint) for axis in axes
        )
        """Drive nodes; only the control loop may change them (`post`)."""
        self.group = DriveGroup(self.drives, plant)
        self.plant: Plant = plant
        self.supervisor: SupervisorNode = SupervisorNode(
            self._send,
            arm=arm,
            group=self.group,
            store=ParameterStore() if store is None else store,
            validate=validate,
            is_heard=lambda node: not self._lost(node),
            later=self._work.put,
        )
        self._nodes: tuple[VirtualNode, ...] = (*self.drives, self.supervisor)
        self._by_number = {node.number: node for node in self._nodes}
        set_hardware_filters(bus, controller_filters(len(self.drives)))
        watched = objects.OPERATOR_NODE << 16 | round(heartbeat_timeout_s * 1e3)
        for node in self._nodes:
            node.answers[objects.HEARTBEAT_CONSUMER, 1] = watched
        self._loop = threading.Thread(target=self._run, name="sarcal-virtual-arm", daemon=True)
        self._worker = threading.Thread(
            target=self._run_work, name="sarcal-virtual-store", daemon=True
        )

    def start(self) -> None:
        """Take a first reading, boot all nodes, inject the faults of SYNC 0, then start the controller's threads."""
        self.group.step()
        for node in self._nodes:
            node.boot()
            node.next_beat_s = self.now_s() + HEARTBEAT_PERIOD_S
        self._inject_due_faults(0)
        self._worker.start()
        self._loop.start()

    def close(self) -> None:
        """End both threads. May be called twice."""
        self._closing = True
        self.running.set()
        self._work.put(None)
        for thread in (self._loop, self._worker):
            if thread.is_alive() and thread is not threading.current_thread():
                thread.join(10.0)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.close()
        if kind is None and self.failure is not None:
            raise self.failure

    def post(self, action: Callable[[], object]) -> None:
        """Run an action in the control loop; if the loop itself calls `post`, the action runs immediately."""
        if threading.get_ident() == self._in_turn:
            action()
        else:
            self._posted.put(action)

    def restart(self) -> None:
        """Power-cycle all nodes; call through `post` only."""
        self._heard_s.clear()
        for node in self._nodes:
            node.on_nmt(NmtCommand.RESET_NODE)

    def attend(self) -> None:
        """Handle queued frames in the caller's thread; do nothing if the controller hangs or is handling frames."""
        if not self._turns.acquire(blocking=False):
            return
        try:
            for _ in range(_CATCH_UP_FRAMES):
                if self._closing or not self.running.is_set():
                    return
                message = self._bus.recv(0.0)
                self._turn(message)
                if message is None:
                    return
        except Exception as error:  # noqa: BLE001 - raised again by whoever runs this controller
            self.failure, self._closing = error, True
        finally:
            self._turns.release()

    def _run(self) -> None:
        raise_loop_priority()
        try:
            while not self._closing:
                delays = self.wire_out.delays or self.wire_in.delays
                wait_s = _SHORT_POLL_S if delays else _POLL_S
                if self._attended:
                    time.sleep(wait_s)
                    self.running.wait()
                    self.attend()
                else:
                    message = self._bus.recv(wait_s)
                    self.running.wait()
                    self._turn(message)
        except Exception as error:  # noqa: BLE001 - raised again by whoever runs this controller
            self.failure = error

    def _turn(self, message: can.Message | None) -> None:
        self._in_turn = threading.get_ident()
        self._latency.frame_read()
        if message is not None:
            self._receive(message)
        self._handle_deadlines()
        while not self._posted.empty():
            self._posted.get()()
        self._in_turn = None

    def _send(self, identifier: int, data: bytes) -> None:
        if self.off_until_s is not None or identifier & _NODE_BITS in self.cut_since_s:
            return
        message = can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
        with self._send_lock:
            for passed in self.wire_out.passed(message):
                self._bus.send(passed)

    def _receive(self, message: can.Message) -> None:
        for passed in self.wire_in.passed(message):
            self._take_in(passed)

    def _take_in(self, message: can.Message) -> None:
        if message.is_extended_id or message.is_remote_frame or message.is_error_frame:
            return
        if self.off_until_s is not None:
            return
        identifier, data = message.arbitration_id, message.data
        number = identifier & _NODE_BITS
        if number in self.cut_since_s:
            return
        node = self._by_number.get(number)
        match identifier - number:
            case objects.COB_SYNC if not number:
                self._on_sync()
            case objects.COB_NMT if not number:
                self._on_nmt(data)
            case objects.COB_RPDO1 if isinstance(node, DriveNode):
                node.on_rpdo1(data)
            case objects.COB_HEARTBEAT if node is None and len(data) == 1:
                self._heard_s[number] = self._latency.listened_s
            case objects.COB_SDO_TO_SERVER if node is not None and len(data) == 8:
                self._on_sdo(node, data)

    def _on_nmt(self, data: bytes | bytearray) -> None:
        if len(data) != 2:
            return
        command, number = data
        for node in self._nodes:
            if number in (0, node.number) and node.number not in self.cut_since_s:
                node.on_nmt(command)

    def _on_sdo(self, node: VirtualNode, data: bytes | bytearray) -> None:
        if "sdo-stall" in node.faults:
            return
        if "sdo-abort" in node.faults and data[0] != sdo.RESPONSE_ABORTED:
            node.send(
                objects.COB_SDO_FROM_SERVER,
                _SDO_REFUSAL.pack(sdo.RESPONSE_ABORTED, data[1:4], sdo.ABORT_GENERAL_ERROR),
            )
        else:
            node.server.on_request(data)

    def _on_sync(self) -> None:
        self.sync_count += 1
        self._inject_due_faults(self.sync_count)
        self.group.step()
        for node in self.drives:
            data = node.tpdo1()
            if data is None:
                continue
            self._send(node.tpdo1_id, data)
            if "double-answers" in node.faults:
                self._send(node.tpdo1_id, data)
        for node in self.drives:
            if "emcy-storm" in node.faults:
                for _ in range(STORM):
                    node.send(objects.COB_EMCY, _STORM_EMERGENCY)

    def _inject_due_faults(self, sync_count: int) -> None:
        while self._script and self._script[-1].at_sync <= sync_count:
            fault = self._script.pop()
            inject(self, fault.kind, fault.joint)

    def _handle_deadlines(self) -> None:
        now = self.now_s()
        with self._send_lock:
            for message in self.wire_out.overdue():
                self._bus.send(message)
        for message in self.wire_in.overdue():
            self._take_in(message)
        if self.off_until_s is not None and now >= self.off_until_s:
            self.off_until_s = None
        holder = self.supervisor.holder
        if holder and self._lost(holder):
            for _ in range(_CATCH_UP_FRAMES):  # the heartbeat may be in the queue
                if (queued := self._bus.recv(0.001)) is None:
                    break
                self._receive(queued)
            holder = self.supervisor.holder
            if holder and self._lost(holder):
                for joint in self.drives:
                    joint.drive.lose_heartbeat()
                self.supervisor.end_control()
        for number, since in self.cut_since_s.items():
            if number <= len(self.drives) and now - since > self._timeout_s:
                self.drives[number - 1].drive.lose_heartbeat()
        for node in self._nodes:
            if now >= node.next_beat_s and "no-heartbeat" not in node.faults:
                # Counted from now, so that a late loop sends no burst.
                node.next_beat_s = now + node.heartbeat_period_s
                node.beat()

    def _lost(self, node: int) -> bool:
        """Whether a node was silent for longer than the time-out; host latency (`LatencyMonitor`) is not counted."""
        return self._latency.listened_s - self._heard_s.get(node, -math.inf) > self._timeout_s

    def _run_work(self) -> None:
        while (work := self._work.get()) is not None:
            try:
                work()
            except Exception as error:  # noqa: BLE001 - raised again by whoever runs this controller
                self.failure = error
