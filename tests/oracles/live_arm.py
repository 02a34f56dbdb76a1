"""A fake arm with its own SYNC thread, a latched STOP and a bus that can become silent, and sessions on it.

Steps of a move, a settling or a capture take no time, or `pace_s`, in which a test can interfere.
"""

import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path

from hardware.arm import (
    ArmIdentity,
    ArmSnapshot,
    DriveState,
    Fault,
    JointMode,
    MoveResult,
    UploadReceipt,
    Watch,
)
from hardware.errors import BusError, DriveDiverged, HardwareError, StopLatched
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.session.ui.runner import Runner
from operator_app.session.ui.sessions import Sessions
from operator_app.session.workflow.opening import Choices, Opening, Rig
from tests.oracles.plant_arm import PERIOD_S, PlantArm, node

TOKEN = 127


class LiveArm(PlantArm):
    """`connect_error` is raised by the next `connect`, `stop_error` by each `stop`."""

    def __init__(
        self, procedure: Procedure, scenario_name: str = "datasheet", *, pace_s: float = 0.0
    ) -> None:
        self.lock = threading.RLock()
        self.pace_s = pace_s
        self.connect_error: HardwareError | None = None
        self.stop_error: HardwareError | None = None
        self.stops: list[float] = []
        self._stop_latch = threading.Event()
        self._diverged: DriveDiverged | None = None
        self._end = threading.Event()
        self._silent_since: float | None = None
        self._stamp = time.monotonic()
        self._drives = DriveState.SWITCH_ON_DISABLED
        self._faults: tuple[Fault, ...] = ()
        self._moving = False
        self._ticker: threading.Thread | None = None
        super().__init__(procedure, scenario_name)
        self._modes = [None] * self.model.joint_count

    def _step(self):
        with self.lock:
            if self._silent_since is None:
                self._stamp = time.monotonic()
            return super()._step()

    def _work_step(self) -> None:
        if self.pace_s:
            self._stop_latch.wait(self.pace_s)
        if self._diverged is not None:
            raise self._diverged
        if self._stop_latch.is_set():
            raise StopLatched("STOP is latched")
        if self._silent_since is not None:
            raise BusError("no answer from the drives")

    def _run_syncs(self) -> None:
        while not self._end.wait(PERIOD_S):
            if self._silent_since is None and self.lock.acquire(blocking=False):
                try:
                    self._step()
                finally:
                    self.lock.release()

    def stop_answering_since(self, seconds: float) -> None:
        """Stop answering, with a last answer of this age."""
        self._silent_since = time.monotonic()
        self._stamp = self._silent_since - seconds

    def answer_again(self) -> None:
        """Answer again, with drives disabled as after a restart of the controller."""
        self._disable_drives()
        self._silent_since = None

    def _disable_drives(self) -> None:
        self._drives, self._modes = DriveState.SWITCH_ON_DISABLED, [None] * self.model.joint_count

    def trip(self, joint: int) -> None:
        fault = {"node": joint, "joint": joint, "code": 0x8311, "text": "torque limit"}
        self._faults = (Fault(**fault, sync_count=self._syncs),)
        self._drives = DriveState.FAULT

    def diverge(self, joint: int, counts: int = 1300) -> None:
        """Stop the arm because one joint differs from its target."""
        self._diverged = DriveDiverged(joint, counts, self._syncs)
        self._stop_latch.set()
        self._drives = DriveState.QUICK_STOP_ACTIVE

    def connect(self) -> ArmIdentity:
        if self.connect_error is not None:
            error, self.connect_error = self.connect_error, None
            raise error
        if self._ticker is None:
            self._end.clear()
            self._ticker = threading.Thread(target=self._run_syncs, name="live-arm", daemon=True)
            self._ticker.start()
        drive = "sarcal virtual joint drive"
        joints = [node(j, 100 + j, drive) for j in range(1, self.model.joint_count + 1)]
        supervisor = node(16, 1, "sarcal virtual supervisor", role="supervisor")
        return replace(super().connect(), nodes=(*joints, supervisor))

    @property
    def connected(self) -> bool:
        return self._ticker is not None

    def snapshot(self) -> ArmSnapshot:
        with self.lock if not self._moving else nullcontext():
            snapshot = super().snapshot()
        # Age 0 while it answers: delays of its own thread do not count.
        age = 0.0 if self._silent_since is None else time.monotonic() - self._stamp
        enabled = self._drives is DriveState.OPERATION_ENABLED
        joints = tuple(
            replace(joint, age_s=age, drive=self._drives, mode=mode if enabled else None)
            for joint, mode in zip(snapshot.joints, self._modes, strict=True)
        )
        return replace(
            snapshot,
            joints=joints,
            heartbeat_age_s=dict.fromkeys((*range(1, 8), 16), age),
            token=TOKEN,
            faults=self._faults,
            stopped=self._stop_latch.is_set(),
            stopped_for="" if self._diverged is None else str(self._diverged),
            moving=self._moving,
        )

    def take_control(self) -> None:
        self._work_step()
        with self.lock:
            super().take_control()
        self._drives = DriveState.OPERATION_ENABLED

    def set_modes(self, modes: Sequence[JointMode]) -> None:
        self._work_step()
        with self.lock:
            super().set_modes(modes)

    def move(
        self,
        targets_rad: Mapping[int, float],
        *,
        speed_rad_per_s: float,
        watch: Watch | None = None,
    ) -> MoveResult:
        def watching(snapshot: ArmSnapshot) -> str | None:
            self._work_step()
            return None if watch is None else watch(snapshot)

        self._work_step()
        self._moving = True
        try:
            return super().move(targets_rad, speed_rad_per_s=speed_rad_per_s, watch=watching)
        finally:
            self._moving = False

    def settle(self, *, window: int, spread_rad: Sequence[float], timeout_syncs: int) -> bool:
        self._work_step()
        return super().settle(window=window, spread_rad=spread_rad, timeout_syncs=timeout_syncs)

    def capture(self, samples: int):
        self._work_step()
        return super().capture(samples)

    def stop(self) -> None:
        self.stops.append(time.monotonic())
        self._stop_latch.set()
        if self._silent_since is None:
            self._drives = DriveState.QUICK_STOP_ACTIVE
        if self.stop_error is not None:
            raise self.stop_error

    def reset_stop(self) -> None:
        self._stop_latch.clear()
        self._diverged = None
        self._faults = ()
        self._disable_drives()

    def upload_parameters(self, document: bytes) -> UploadReceipt:
        receipt = super().upload_parameters(document)
        return replace(receipt, sha256="0" * 64)

    def close(self) -> bool:
        self.closed += self.connected
        self._end.set()
        if self._ticker is not None:
            self._ticker.join()
            self._ticker = None
        self._diverged = None
        return True


def quick_procedure() -> Procedure:
    """The packaged hinge procedure with few poses, and an acceptance limit for them."""
    procedure = load_procedure("hinge")
    return replace(
        procedure,
        capture=replace(procedure.capture, poses=6, samples_per_pose=8),
        acceptance=replace(procedure.acceptance, scaled_condition_number=400.0),
    )


class FakeSessions(Sessions):
    """Sessions on live fake arms, in folders session-1, session-2, ...; `arm` is the current one."""

    def __init__(self, root: Path) -> None:
        super().__init__("hinge", Choices(), root=root, join=self._joined)
        self.root, self.simulated = root, True
        self.procedure = quick_procedure()
        self.pace_s = 0.0
        self.arm: LiveArm | None = None
        self._made = 0

    @property
    def runner(self) -> Runner | None:
        return self._runner

    @contextmanager
    def _joined(self, opening: Opening) -> Iterator[Rig]:
        procedure, folder = opening.procedure, opening.folder
        if not opening.resumed:
            self._made += 1
            folder = self.root / f"session-{self._made}"
        if procedure.name == self.procedure.name:
            procedure = self.procedure
        self.arm = LiveArm(procedure, pace_s=self.pace_s)
        test_opening = replace(opening, folder=folder, procedure=procedure)
        yield Rig(arm=self.arm, opening=test_opening, simulated=self.simulated)
