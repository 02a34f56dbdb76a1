"""A fake arm: the virtual plant behind `ArmInterface`, without a bus."""

from collections.abc import Mapping, Sequence

import numpy as np

from hardware.arm import (
    NO_LATENCY,
    ArmIdentity,
    ArmSnapshot,
    DriveState,
    JointMode,
    JointState,
    MoveResult,
    NodeIdentity,
    Reading,
    UploadReceipt,
    Watch,
)
from hardware.control.trajectory import StraightMove
from hardware.errors import UploadRefused
from hardware.virtual.axis import PlantReading
from hardware.virtual.scenarios import Scenario, scenario
from operator_app.config.parameters_file import parse_parameters
from operator_app.config.procedure import Procedure
from solver.chain.sensors import NoSensor

PERIOD_S = 0.01
SERIAL = "SDA-0001"


def node(number: int, serial: int, device_name: str, *, role: str = "") -> NodeIdentity:
    """Identity of a node, by default of the drive of joint `number`."""
    return NodeIdentity(
        node=number, role=role or f"joint {number}", device_name=device_name, vendor_id=0,
        product_code=1, revision=0x10000, serial_number=serial,
    )  # fmt: skip


class PlantArm:
    """An `ArmInterface` whose SYNCs are plant steps. Records its moves and how often it was closed.

    `off_rad` (n,) is added to readings; `reads_rad` replaces readings of joints; `lateness` is the computer's.
    """

    def __init__(self, procedure: Procedure, chosen: Scenario | str, serial: str = SERIAL) -> None:
        self.model = procedure.arm
        chosen = scenario(chosen) if isinstance(chosen, str) else chosen
        self.plant = chosen.build(procedure.arm)
        n = self.model.joint_count
        sensors = [joint.sensor for joint in self.model.joints]
        resolution = [0.0 if isinstance(s, NoSensor) else s.resolution_rad for s in sensors]
        self._resolution = np.array(resolution)
        self._serial = serial
        self._modes: list[JointMode | None] = [None] * n
        self._targets = np.zeros(n)
        self._syncs = 0
        self._document = b""
        self.off_rad = np.zeros(n)
        self.reads_rad: dict[int, float] = {}
        self.interrupt_at_sync: int | None = None
        self.lateness = NO_LATENCY
        self.closed = 0
        self.moves: list[tuple[dict[int, float], float]] = []
        self._step()
        self._hold_here()

    def _step(self) -> PlantReading:
        if self.interrupt_at_sync is not None and self._syncs >= self.interrupt_at_sync:
            raise KeyboardInterrupt
        self._syncs += 1
        self._reading = self.plant.step(list(zip(self._modes, self._targets, strict=True)))
        return self._reading

    def _positions(self) -> np.ndarray:
        return np.array(self._reading.position_counts) * self._resolution

    def _with_errors(self, q_rad: np.ndarray) -> np.ndarray:
        readings = q_rad + self.off_rad
        for joint, reads in self.reads_rad.items():
            readings[joint - 1] = reads
        return readings

    def _hold_here(self) -> None:
        self._targets = self._positions()

    def connect(self) -> ArmIdentity:
        nodes = (node(1, 1, "fake"),)
        return ArmIdentity(model=self.model.name, serial_number=self._serial, nodes=nodes)

    def snapshot(self) -> ArmSnapshot:
        readings = self._with_errors(self._positions())
        joints = tuple(
            JointState(
                joint=j + 1,
                position_counts=self._reading.position_counts[j],
                position_rad=float(readings[j]),
                speed_rad_per_s=self._reading.speed_rad_per_s[j],
                torque_nm=self._reading.torque_nm[j],
                drive=DriveState.OPERATION_ENABLED,
                mode=self._modes[j],
                age_s=0.0,
            )
            for j in range(self.model.joint_count)
        )
        return ArmSnapshot(
            sync_count=self._syncs, joints=joints, heartbeat_age_s={}, token=127, faults=(),
            stopped=False, moving=False, lateness=self.lateness,
        )  # fmt: skip

    def take_control(self) -> None:
        self._hold_here()
        self._modes = [JointMode.POSITION] * self.model.joint_count

    def set_modes(self, modes: Sequence[JointMode]) -> None:
        self._hold_here()
        self._modes = list(modes)

    def move(
        self,
        targets_rad: Mapping[int, float],
        *,
        speed_rad_per_s: float,
        watch: Watch | None = None,
    ) -> MoveResult:
        self.moves.append((dict(targets_rad), speed_rad_per_s))
        columns = [j - 1 for j in targets_rad]
        path = StraightMove(
            self._targets[columns],
            np.array(list(targets_rad.values())),
            speed_rad_per_s=speed_rad_per_s,
        )
        first, reason = self._syncs, ""
        while not path.finished:
            self._targets[columns] = path.next()
            self._step()
            if not reason and watch is not None:
                reason = watch(self.snapshot()) or ""
                if reason:
                    path.brake()
        return MoveResult(
            reached=not reason,
            reason=reason,
            positions_rad=self._positions(),
            syncs=self._syncs - first,
        )

    def settle(self, *, window: int, spread_rad: Sequence[float], timeout_syncs: int) -> bool:
        positions: list[np.ndarray] = []
        for _ in range(timeout_syncs):
            self._step()
            positions.append(self._positions())
            spread = np.ptp(positions[-window:], axis=0)
            if len(positions) >= window and np.all(spread <= spread_rad):
                return True
        return False

    def capture(self, samples: int) -> Reading:
        first = self._syncs + 1
        counts = np.array([self._step().position_counts for _ in range(samples)], dtype=float)
        mean = counts.mean(axis=0)
        readings = self._with_errors(mean * self._resolution)
        offset_counts = np.divide(
            readings - mean * self._resolution,
            self._resolution,
            out=np.zeros_like(mean),
            where=self._resolution > 0.0,
        )
        return Reading(
            mean_counts=mean + offset_counts,
            mean_rad=readings,
            sd_rad=counts.std(axis=0, ddof=1) * self._resolution,
            samples=samples,
            first_sync=first,
        )

    def hold(self) -> None:
        self.take_control()

    def stop(self) -> None:
        self.hold()

    def reset_stop(self) -> None:
        pass

    def upload_parameters(self, document: bytes) -> UploadReceipt:
        parsed = parse_parameters(document)
        if parsed.arm.serial != self._serial:
            raise UploadRefused(f"these parameters belong to arm {parsed.arm.serial}")
        self._document = document
        return UploadReceipt(
            slot="A",
            sha256="",
            length=len(document),
            home_offset_counts=tuple(j.home_offset_counts or 0 for j in parsed.joints),
        )

    def active_parameters(self) -> bytes:
        return self._document

    def close(self) -> bool:
        self.hold()
        self.closed += 1
        return True
