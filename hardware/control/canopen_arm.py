"""An arm on CANopen: the `hardware.arm.ArmInterface` protocol on one bus."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Final

from hardware import errors
from hardware.arm import (
    ArmSnapshot,
    DriveState,
    JointMode,
    MoveResult,
    Reading,
    UploadReceipt,
    Watch,
)
from hardware.canopen import objects
from hardware.canopen.cia402 import CLOSED_LOOP_STATES, TargetState, conditions, state_of
from hardware.canopen.cyclic import Sample
from hardware.canopen.sdo import MAX_DOCUMENT_BYTES, ObjectAccess
from hardware.command_limits import admit_move, not_enabled
from hardware.control import motion_steps, uploading
from hardware.control.alarms import stop_error
from hardware.control.connectable_arm import ConnectableArm, release_arm

MODE_ATTEMPTS: Final = 6
_NO_REASON_AGAINST_UPLOAD: Final = (
    errors.Stopped,
    errors.DriveFault,
    errors.TargetRefused,
    errors.ControlDenied,
)
"""Alarms that do not prevent an upload, because they leave the joints' counters unchanged; a failed sensor does prevent
one. If another node has control, the upload itself raises an error."""


class CanopenArm(ConnectableArm):
    """An arm of CiA 402 joints on a CAN bus, with or without a supervisor; see `hardware.arm.ArmInterface`."""

    def snapshot(self) -> ArmSnapshot:
        """Return the latest state; never blocks, and may be called from any thread."""
        return self._link.snapshot()

    def take_control(self) -> None:
        """Take the control token and enable all drives in position mode at their measured positions.

        If that fails, the drives are switched off again, so that a slow drive is not enabled later.
        """
        link, loop = self._link, self._link.loop
        self._raise_if_stopped()
        if link.other_operator():
            raise errors.ControlDenied(objects.OPERATOR_NODE)
        link.take_token()
        timeout_s = link.profile.enabling_timeout_s
        syncs = round(timeout_s / objects.CONTROL_PERIOD_S)
        try:
            not_reached = loop.run(motion_steps.drive_to(loop, TargetState.ENABLED, syncs))
            link.read_modes()
            within = f"enabled within {timeout_s:g} s (enabling_timeout_s of the bus profile)"
            self._raise_for_drives(not_reached, within)
        except BaseException as failure:
            if loop.commands is not None and not loop.latch.latched:
                last = release_arm(loop)
                if isinstance(failure, errors.HardwareError):
                    failure.drives_after = _power_after(last)
            raise

    def set_modes(self, modes: Sequence[JointMode]) -> None:
        """Set one mode per joint; return when 6061h of every drive confirms it.

        Raises `ModeNotReached` for the first joint whose drive does not report the mode or, in position mode, does not
        report that it follows its target. If a drive does not report the mode, all joints are put into position mode
        before the error is raised: with too few joints in position mode, the arm would sag.
        """
        if len(modes) != self.joints:
            raise ValueError(f"{self.joints} joints need one mode each, not {len(modes)}")
        # An unknown mode must not reach the control loop.
        modes = [JointMode(mode) for mode in modes]
        try:
            self._set_modes(modes)
        except errors.ModeNotReached:
            with suppress(errors.HardwareError):
                self.hold()
            raise
        if (joint := motion_steps.not_following(self._link.loop.sample, modes)) is not None:
            actual = "it, but not that it follows its target (6041h, bit 12)"
            raise errors.ModeNotReached(joint, JointMode.POSITION.value, actual, not_following=True)

    def _set_modes(
        self, modes: Sequence[JointMode], *, despite: tuple[type[errors.HardwareError], ...] = ()
    ) -> None:
        link = self._link
        self._raise_if_stopped()
        tripped = link.loop.sample.joints_in({DriveState.FAULT})
        self._raise_for_drives(tripped, "given a mode")
        if (refused := not_enabled(link.loop.sample)) is not None:
            raise refused
        for _ in range(MODE_ATTEMPTS):
            link.loop.run(motion_steps.change_modes(link.loop, modes), despite=despite)
            link.read_modes()
            waits = motion_steps.not_following(link.loop.sample, modes)
            if link.modes == tuple(modes) and not waits:
                return
        for joint, (requested, actual) in enumerate(zip(modes, link.modes, strict=True), 1):
            if requested is not actual:
                name = "neither position nor free" if actual is None else actual.value
                raise errors.ModeNotReached(joint, requested.value, name)

    def move(
        self,
        targets_rad: Mapping[int, float],
        *,
        speed_rad_per_s: float,
        watch: Watch | None = None,
    ) -> MoveResult:
        """Move joints in position mode to their targets, in a straight line in joint space.

        Raises `CommandRefused` before anything moves, `Stopped` at once, and other errors once the joints are at rest.
        """
        link = self._link
        self._raise_if_stopped()
        joints, in_control = link.snapshot().joints, link.in_control
        limits, scales = link.limits, link.scales
        admit_move(limits, scales, joints, targets_rad, speed_rad_per_s, in_control=in_control)
        result = link.loop.run(motion_steps.move(link, dict(targets_rad), speed_rad_per_s, watch))
        if not result.reached:
            link.require_same_maps()
        return result

    def settle(self, *, window: int, spread_rad: Sequence[float], timeout_syncs: int) -> bool:
        """Wait until each joint's last `window` positions span no more than `spread_rad`; false on time-out."""
        link = self._link
        return link.loop.run(motion_steps.settle(link, window, spread_rad, timeout_syncs))

    def capture(self, samples: int) -> Reading:
        """Average `samples` samples, each latched on one SYNC; `MappingChanged` if a drive's PDO map was changed."""
        if samples < 1:
            raise ValueError("a reading needs at least one sample")
        link = self._link
        reading = link.loop.run(motion_steps.capture(link, samples))
        link.require_same_maps()
        return reading

    def hold(self) -> None:
        """Put all joints into position mode: free joints at their positions, the others at their last targets."""
        # A sensor fault or another master is no reason not to hold.
        despite = (errors.SensorFault, errors.OtherMaster)
        self._set_modes([JointMode.POSITION] * self.joints, despite=despite)

    def reset_stop(self) -> None:
        """Clear the STOP latch and the drives' faults; the drives stay disabled until `take_control`.

        Raises `Stopped` if STOP was pressed again during the reset, `DriveFault` if a fault cannot be cleared.
        """
        link, press = self._link, self._latch.last_press
        despite = errors.Stopped, errors.DriveFault, errors.SensorFault, errors.OtherMaster
        not_reached = link.loop.run(motion_steps.reset(link.loop, press=press), despite=despite)
        link.read_modes()
        self._raise_if_stopped()
        self._raise_for_drives(not_reached, "reset")

    @property
    def access(self) -> ObjectAccess:
        """Object access (SDO) to the nodes."""
        return self._link.access

    def upload_parameters(self, document: bytes) -> UploadReceipt:
        """Stage, read back and commit a document, and read the home offsets back.

        The drives may be off, stopped or in fault. The control token is taken if nobody has it. An error is raised
        before anything is sent if another node is in control, or if a drive has restarted, has lost counts or has a
        failed sensor (7305h): home offsets are then doubtful. Later, the errors of `uploading.upload` may be raised.
        """
        link = self._link
        link.loop.run(motion_steps.check_alarms(link.loop), despite=_NO_REASON_AGAINST_UPLOAD)
        for fault in link.loop.nodes.faults:
            if fault.joint is not None and fault.code == objects.EmergencyCode.SENSOR:
                raise errors.DriveFault(fault.joint, fault.code, fault.text, tripped=False)
        if not link.in_control:
            if link.token or link.other_operator():
                raise errors.CommandRefused(
                    "parameters can be uploaded only in control: take control first"
                )
            link.take_token()
        return uploading.upload(link, document)

    def active_parameters(self) -> bytes:
        """Read the controller's active parameter document; empty if there is no document or no supervisor."""
        supervisor = self._link.profile.supervisor
        if supervisor is None:
            return b""
        try:
            return self._link.access.read(
                supervisor, objects.DOCUMENT, max_bytes=MAX_DOCUMENT_BYTES
            )
        except errors.SdoRefused as refused:
            if refused.code == objects.Abort.NO_DATA:
                return b""
            raise

    def _raise_if_stopped(self) -> None:
        if self._latch.latched:
            raise stop_error(self._link.loop.watch.divergence)

    def _raise_for_drives(self, joints: tuple[int, ...], required: str) -> None:
        for joint in joints:
            link = self._link
            status = link.loop.sample.statuswords[joint - 1]
            state = state_of(status)
            if state is DriveState.FAULT:
                code = link.access.read_unsigned(link.profile.drives[joint - 1], objects.ERROR_CODE)
                raise errors.DriveFault(joint, code, objects.emergency_text(code))
            failed = f" cannot be {required}"
            raise errors.DriveNotReady(
                joint, state.value, failed=failed, conditions=conditions(status)
            )


def _power_after(sample: Sample | None) -> str:
    if sample is None:
        return "Drives may still have power, since the arm does not answer: use the hardware stop"
    powered = sample.joints_in(CLOSED_LOOP_STATES)
    if not powered:
        return "All drives have been switched off again"
    who, have = ("joint", "has") if len(powered) == 1 else ("joints", "have")
    joints = f"{who} {', '.join(map(str, powered))} still {have} power"
    return f"All drives were commanded off again; {joints}: use the hardware stop"
