"""An arm of another package behind this program's own limits, STOP latch and words. Knows no bus.

Who writes an arm need not do these again: a command that the limits refuse does not reach it, nothing
moves while STOP is latched, a STOP that comes while a command is under way is sent after it once more, and
whatever it raises, or reads that is no number, becomes words that name its package.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from hardware.arm import (
    Arm,
    ArmIdentity,
    ArmSnapshot,
    FloatArray,
    JointMode,
    MoveResult,
    Reading,
    UploadReceipt,
    Watch,
)
from hardware.arm_description import ArmDescription
from hardware.control.stop_line import StopLatch
from hardware.errors import (
    BusError,
    CommandRefused,
    HardwareError,
    ModeNotReached,
    StopLatched,
    Stopped,
)
from hardware.limits import JointLimits, Situation, joint_limits, refuse_command, refuse_move

PERIOD_S = 0.01
"""Of no weight here: whole moves are judged, not single steps."""


class OutsideArm:
    """An `Arm` around that of `make`, which is called at `connect`.

    Parameters
    ----------
    make
        Makes the arm, unconnected.
    description
        The arm file's joints, whose ranges and speeds are the limits.
    name
        What it is called in errors.
    keeps_parameters
        Whether it takes a parameter document, as its offer says.
    record_to
        Where `make` is to have it recorded; None for nowhere.

    Attributes
    ----------
    record_to
        As above: of the next connection.
    """

    def __init__(
        self,
        make: Callable[[], Arm],
        description: ArmDescription,
        name: str,
        *,
        keeps_parameters: bool = False,
        record_to: Path | None = None,
    ) -> None:
        self.record_to = record_to
        self._keeps_parameters = keeps_parameters
        self._make, self._description, self._name = make, description, name
        self._arm: Arm | None = None
        self._latch = StopLatch()  # a new connection does not lift a STOP
        self._in_control = False
        self._closing, self._left_held = False, True
        self._close_lock = threading.RLock()
        self._limits: tuple[JointLimits, ...] = tuple(
            joint_limits(
                number,
                joint.scale,
                lower_rad=joint.lower_rad,
                upper_rad=joint.upper_rad,
                max_speed_rad_per_s=joint.max_speed_rad_per_s,
                period_s=PERIOD_S,
            )
            for number, joint in enumerate(description.joints, 1)
        )

    def connect(self) -> ArmIdentity:
        """Make the arm and connect it; what it says of itself has to fit the arm file.

        Raises
        ------
        HardwareError
            The arm is closed again.
        """
        if self._arm is not None:
            raise ValueError("this arm is connected already")
        with self._in_words():
            arm = self._make()
        try:
            with self._in_words():
                identity = arm.connect()
                self._look(arm)
        except BaseException:
            with self._in_words():
                arm.close()
            raise
        self._arm = arm
        return replace(identity, keeps_parameters=self._keeps_parameters)

    def close(self) -> bool:
        """Leave the arm held, its drives off; False if it did not answer.

        Safe to call twice, from any thread; a second one waits until the arm is closed.
        """
        with self._close_lock:
            arm = self._arm
            if arm is None or self._closing:  # closing: called again by the thread that closes
                return self._left_held
            self._closing, self._left_held = True, False
            try:
                with self._in_words():
                    self._left_held = arm.close()
            except HardwareError:
                pass
            finally:
                # Not before: STOP has to reach the arm to the last moment.
                self._arm, self._in_control, self._closing = None, False, False
            return self._left_held

    def snapshot(self) -> ArmSnapshot:
        """Return the latest state, with this program's own STOP latch in it."""
        found = self._look(self._there)
        return replace(found, stopped=True) if self._latch.latched else found

    def take_control(self) -> None:
        """Enable the drives, holding."""
        self._require_no_stop()
        with self._stopped_after_all(), self._in_words():
            self._there.take_control()
        self._in_control = True

    def set_modes(self, modes: Sequence[JointMode]) -> None:
        """Ask for one mode per joint, and look whether the arm says so."""
        if len(modes) != len(self._limits):
            raise ValueError(f"{len(self._limits)} joints need as many modes, not {len(modes)}")
        self._require_no_stop()
        self._require_control()
        with self._stopped_after_all(), self._in_words():
            self._there.set_modes(modes)
        joints = self._look(self._there).joints
        for joint, wanted in zip(joints, modes, strict=True):
            if joint.mode is not wanted:
                found = "no mode" if joint.mode is None else joint.mode.value
                raise ModeNotReached(joint.joint, wanted.value, found)

    def move(
        self,
        targets_rad: Mapping[int, float],
        *,
        speed_rad_per_s: float,
        watch: Watch | None = None,
    ) -> MoveResult:
        """Move; refused before it reaches the arm if a limit is against it.

        Raises
        ------
        CommandRefused, Stopped
        """
        self._require_no_stop()
        joints = self._look(self._there).joints
        for number, target in targets_rad.items():
            if not 1 <= number <= len(self._limits):
                raise ValueError(f"there is no joint {number}")
            limits, state = self._limits[number - 1], joints[number - 1]
            scale = self._description.joints[number - 1].scale
            situation = Situation(
                stopped=False, in_control=self._in_control, drive=state.drive, mode=state.mode
            )
            refusal = refuse_command(limits, situation) or refuse_move(
                limits, scale.counts_of(target), speed_rad_per_s
            )
            if refusal is not None:
                raise CommandRefused(refusal.text)
        own: list[BaseException] = []

        def watching(snapshot: ArmSnapshot) -> str | None:
            if self._latch.latched:
                self._there.stop()  # the move may have begun after it
                return "STOP"
            try:
                return None if watch is None else watch(snapshot)
            except BaseException as error:
                own.append(error)
                raise

        with self._stopped_after_all(), self._in_words(own):
            return self._there.move(targets_rad, speed_rad_per_s=speed_rad_per_s, watch=watching)

    def settle(self, *, window: int, spread_rad: Sequence[float], timeout_syncs: int) -> bool:
        """Wait until no joint's position spreads more than `spread_rad` over `window` samples."""
        if len(spread_rad) != len(self._limits) or window < 1:
            raise ValueError("settling needs one spread per joint and a window of at least 1")
        with self._in_words():
            return self._there.settle(
                window=window, spread_rad=spread_rad, timeout_syncs=timeout_syncs
            )

    def capture(self, samples: int) -> Reading:
        """Read `samples` samples."""
        if samples < 1:
            raise ValueError("a reading needs at least one sample")
        with self._in_words():
            reading = self._there.capture(samples)
            for what in ("mean_counts", "mean_rad", "sd_rad"):
                self._require_numbers(what, getattr(reading, what))
        return reading

    def hold(self) -> None:
        """All joints to position mode where they are."""
        self._require_no_stop()
        with self._stopped_after_all(), self._in_words():
            self._there.hold()

    def stop(self) -> None:
        """Latch, and stop the arm. From any thread."""
        self._latch.press()
        with self._in_words():
            self._there.stop()

    def reset_stop(self) -> None:
        """Clear what the arm latched, then the latch; the drives stay disabled until `take_control`."""
        press = self._latch.last_press
        self._in_control = False
        with self._in_words():
            self._there.reset_stop()
        if not self._latch.release(press):
            raise Stopped("STOP was pressed again meanwhile: it stays latched")

    def upload_parameters(self, document: bytes) -> UploadReceipt:
        """Upload to a controller that keeps parameters."""
        self._require_control()
        with self._in_words():
            return self._there.upload_parameters(document)

    def active_parameters(self) -> bytes:
        """Read what the controller keeps; empty if nothing."""
        with self._in_words():
            return self._there.active_parameters()

    @property
    def _there(self) -> Arm:
        if self._arm is None:
            raise BusError("The arm is not connected.")
        return self._arm

    def _look(self, arm: Arm) -> ArmSnapshot:
        """Return the snapshot of `arm`, looked over: every joint of the arm file, where it is a number."""
        n = len(self._description.joints)
        with self._in_words():
            found = arm.snapshot()
            if [joint.joint for joint in found.joints] != list(range(1, n + 1)):
                raise BusError(
                    f"{self._name} has {len(found.joints)} joints, and {self._description.model} has {n}: name "
                    "the arm file that describes it"
                )
            self._require_numbers("position_rad", found.positions_rad)
        return found

    def _require_numbers(self, what: str, values: Sequence[float] | FloatArray) -> None:
        """Refuse what is not one finite number for each joint."""
        n, found = len(self._description.joints), np.asarray(values, dtype=float)
        if found.shape != (n,):
            raise BusError(
                f"{self._name}: {what} has shape {found.shape}, one value for each of {n} joints is needed. "
                "Tell its author; nothing was captured"
            )
        for number, value in enumerate(found, 1):
            if not np.isfinite(value):
                raise BusError(
                    f"{self._name}: {what} of joint {number} is {value}. Look at its sensor, or tell the arm's "
                    "author; nothing was captured"
                )

    @contextmanager
    def _stopped_after_all(self) -> Iterator[None]:
        """Send STOP once more after a command that it was pressed during: the command may have undone it.

        Raises
        ------
        Stopped
            Whatever else came of the command.
        """
        try:
            yield
        finally:
            if self._latch.latched:
                with self._in_words():
                    self._there.stop()
                raise StopLatched("STOP came meanwhile: reset it before anything moves again")

    def _require_no_stop(self) -> None:
        if self._latch.latched:
            raise StopLatched("STOP is latched: reset it before anything moves again")

    def _require_control(self) -> None:
        if not self._in_control:
            raise CommandRefused("the drives are not under control: take control first")

    @contextmanager
    def _in_words(self, ours: Sequence[BaseException] = ()) -> Iterator[None]:
        """Let hardware errors and our own pass; put anything else that the arm raises into words."""
        try:
            yield
        except HardwareError:
            raise
        except Exception as error:  # an arm of somebody else's may break in any way
            if error in ours:
                raise
            raise BusError(
                f"{self._name} broke: {type(error).__name__}: {error}. Tell its author; nothing was captured "
                "since"
            ) from error
