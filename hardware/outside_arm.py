"""Wraps an arm of another package with this program's limits, STOP latch and error messages.

Commands that the limits refuse do not reach the arm, and nothing moves while STOP is latched. A STOP pressed during a
command is sent again after the command. Exceptions and invalid readings become errors that name the package.
"""

import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np

from hardware import errors
from hardware.arm import (
    ArmIdentity,
    ArmInterface,
    ArmSnapshot,
    FloatArray,
    JointMode,
    MoveResult,
    Reading,
    UploadReceipt,
    Watch,
)
from hardware.arm_plugins import ArmOffer, ArmOrder
from hardware.command_limits import admit_move, arm_limits
from hardware.control.stop_line import StopLatch


class OutsideArm:
    """An `ArmInterface` that wraps the arm of another package; `connect` makes that arm, with `offer.make(order)`.

    Moves are limited to the ranges and speeds of the ordered joints. `name`: the arm's name for messages. `record_to`:
    file for recording the next connection, or None.
    """

    def __init__(self, offer: ArmOffer, order: ArmOrder, name: str) -> None:
        self.record_to = order.record_to
        self._offer, self._order, self._name = offer, order, name
        self._description = order.description
        self._arm: ArmInterface | None = None
        self._latch = StopLatch()  # a new connection does not lift a STOP
        self._in_control = False
        self._closing, self._left_held = False, True
        self._close_lock = threading.RLock()
        self._scales = [joint.scale for joint in order.description.joints]
        self._limits = arm_limits(order.description.joints, self._scales)

    def connect(self) -> ArmIdentity:
        """Make the arm, connect it and compare its joints with the arm file; on an error, close the arm again."""
        if self._arm is not None:
            raise ValueError("this arm is connected already")
        with self._translated_errors():
            arm = self._offer.make(replace(self._order, record_to=self.record_to))
        try:
            with self._translated_errors():
                identity = arm.connect()
                self._checked_snapshot(arm)
        except BaseException:
            with self._translated_errors():
                arm.close()
            raise
        self._arm = arm
        return replace(identity, keeps_parameters=self._offer.keeps_parameters)

    def close(self) -> bool:
        """Close the arm; false on failure or if a drive may still obey commands. May be called twice, by any thread."""
        with self._close_lock:
            arm = self._arm
            if arm is None or self._closing:  # closing: re-entered by the closing thread
                return self._left_held
            self._closing, self._left_held = True, False
            try:
                with suppress(errors.HardwareError), self._translated_errors():
                    self._left_held = arm.close()
            finally:
                # Not before: STOP needs the arm until it is closed.
                self._arm, self._in_control, self._closing = None, False, False
            return self._left_held

    def snapshot(self) -> ArmSnapshot:
        """Return the latest state, with this program's STOP latch."""
        snapshot = self._checked_snapshot(self._connected)
        return replace(snapshot, stopped=True) if self._latch.latched else snapshot

    def take_control(self) -> None:
        """Take control and enable the drives; raises `StopLatched` if STOP is latched."""
        with self._command():
            self._connected.take_control()
        self._in_control = True

    def set_modes(self, modes: Sequence[JointMode]) -> None:
        """Set one mode per joint and check that the arm reports these modes; if it does not, hold all joints."""
        if len(modes) != len(self._limits):
            raise ValueError(f"{len(self._limits)} joints need one mode each, not {len(modes)}")
        self._require_no_stop()
        if not self._in_control:
            raise errors.CommandRefused("the drives are not under control: take control first")
        try:
            with self._command():
                self._connected.set_modes(modes)
            joints = self._checked_snapshot(self._connected).joints
            for joint, requested in zip(joints, modes, strict=True):
                if joint.mode is not requested:
                    actual = "no mode" if joint.mode is None else joint.mode.value
                    raise errors.ModeNotReached(joint.joint, requested.value, actual)
        except errors.ModeNotReached:
            # Too few joints in position mode would let the arm sag.
            with suppress(errors.HardwareError):
                self.hold()
            raise

    def move(
        self,
        targets_rad: Mapping[int, float],
        *,
        speed_rad_per_s: float,
        watch: Watch | None = None,
    ) -> MoveResult:
        """Move to the targets; if a limit forbids it, raise `CommandRefused` and send nothing to the arm."""
        self._require_no_stop()
        joints, in_control = self._checked_snapshot(self._connected).joints, self._in_control
        limits, scales = self._limits, self._scales
        admit_move(limits, scales, joints, targets_rad, speed_rad_per_s, in_control=in_control)
        own: list[BaseException] = []

        def watching(snapshot: ArmSnapshot) -> str | None:
            if self._latch.latched:
                self._connected.stop()  # the move may have begun after the first STOP
                return "STOP"
            try:
                return None if watch is None else watch(snapshot)
            except BaseException as error:
                own.append(error)
                raise

        with self._command(own):
            return self._connected.move(
                targets_rad, speed_rad_per_s=speed_rad_per_s, watch=watching
            )

    def settle(self, *, window: int, spread_rad: Sequence[float], timeout_syncs: int) -> bool:
        """Wait until each joint's last `window` positions span no more than `spread_rad`; false on time-out."""
        with self._translated_errors():
            return self._connected.settle(
                window=window, spread_rad=spread_rad, timeout_syncs=timeout_syncs
            )

    def capture(self, samples: int) -> Reading:
        """Return the average of `samples` samples."""
        with self._translated_errors():
            reading = self._connected.capture(samples)
            for what in ("mean_counts", "mean_rad", "sd_rad"):
                self._require_numbers(what, getattr(reading, what))
        return reading

    def hold(self) -> None:
        """Put all joints into position mode (`ArmInterface.hold`); raises `StopLatched` if STOP is latched."""
        with self._command():
            self._connected.hold()

    def stop(self) -> None:
        """Latch STOP and stop the arm. May be called from any thread."""
        self._latch.press()
        with self._translated_errors():
            self._connected.stop()

    def reset_stop(self) -> None:
        """Reset the arm's stop, then the latch; the drives stay disabled until `take_control`."""
        press = self._latch.last_press
        self._in_control = False
        with self._translated_errors():
            self._connected.reset_stop()
        if not self._latch.release(press):
            raise errors.Stopped("STOP was pressed again during the reset: it stays latched")

    def upload_parameters(self, document: bytes) -> UploadReceipt:
        """Upload a parameter document to the arm's controller; no drive has to be enabled."""
        with self._translated_errors():
            return self._connected.upload_parameters(document)

    def active_parameters(self) -> bytes:
        """Read the controller's document; empty if there is none."""
        with self._translated_errors():
            return self._connected.active_parameters()

    @property
    def _connected(self) -> ArmInterface:
        if self._arm is None:
            raise errors.BusError("The arm is not connected.")
        return self._arm

    def _checked_snapshot(self, arm: ArmInterface) -> ArmSnapshot:
        n = len(self._description.joints)
        with self._translated_errors():
            snapshot = arm.snapshot()
            if [joint.joint for joint in snapshot.joints] != list(range(1, n + 1)):
                raise errors.BusError(
                    f"{self._name} has {len(snapshot.joints)} joints, and {self._description.model} has {n}: name "
                    "the arm file that describes it"
                )
            self._require_numbers("position_rad", snapshot.positions_rad)
        return snapshot

    def _require_numbers(self, what: str, values: Sequence[float] | FloatArray) -> None:
        n, numbers = len(self._description.joints), np.asarray(values, dtype=float)
        if numbers.shape != (n,):
            raise errors.BusError(
                f"{self._name}: {what} has shape {numbers.shape} instead of one value for each of {n} joints. "
                "Report this to the author of the arm's package. Nothing was captured"
            )
        for number, value in enumerate(numbers, 1):
            if not np.isfinite(value):
                raise errors.BusError(
                    f"{self._name}: {what} of joint {number} is {value}. Check the joint's sensor, or report this to "
                    "the author of the arm's package. Nothing was captured"
                )

    @contextmanager
    def _command(self, own: Sequence[BaseException] = ()) -> Iterator[None]:
        """Context for a command to the arm. Errors become `HardwareError`; errors in `own` are raised unchanged.

        Raises `StopLatched` if STOP is latched. A STOP pressed meanwhile is sent again, since the command may undo it.
        """
        self._require_no_stop()
        try:
            with self._translated_errors(own):
                yield
        finally:
            if self._latch.latched:
                with self._translated_errors():
                    self._connected.stop()
                raise errors.StopLatched("STOP was pressed: reset it before anything moves again")

    def _require_no_stop(self) -> None:
        if self._latch.latched:
            raise errors.StopLatched("STOP is latched: reset it before anything moves again")

    @contextmanager
    def _translated_errors(self, own: Sequence[BaseException] = ()) -> Iterator[None]:
        try:
            yield
        except errors.HardwareError:
            raise
        except Exception as error:
            if error in own:
                raise
            raise errors.BusError(
                f"{self._name} failed ({type(error).__name__}: {error}). Report this to the author of the arm's "
                "package. Nothing has been captured since the failure"
            ) from error
