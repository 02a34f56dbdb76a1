"""An arm of another package behind this program's own limits, STOP latch and words. Knows no bus.

Who writes an arm need not do these again: a command that the limits refuse does not reach it, nothing
moves while STOP is latched, and whatever it raises becomes words that name its package.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace

from hardware.arm import (
    Arm,
    ArmIdentity,
    ArmSnapshot,
    JointMode,
    MoveResult,
    Reading,
    UploadReceipt,
    Watch,
)
from hardware.description import ArmDescription
from hardware.errors import BusError, CommandRefused, HardwareError, ModeNotReached, Stopped
from hardware.limits import JointLimits, Situation, joint_limits, refuse_command, refuse_move
from hardware.stop_line import StopLatch

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
    """

    def __init__(self, make: Callable[[], Arm], description: ArmDescription, name: str) -> None:
        self._make, self._description, self._name = make, description, name
        self._arm: Arm | None = None
        self._latch = StopLatch()  # a new connection does not lift a STOP
        self._in_control = False
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
        n = len(self._description.joints)
        with self._in_words():
            arm = self._make()
        try:
            with self._in_words():
                identity, joints = arm.connect(), arm.snapshot().joints
            if [joint.joint for joint in joints] != list(range(1, n + 1)):
                raise BusError(
                    f"{self._name} has {len(joints)} joints, and {self._description.model} has {n}: name the "
                    "arm file that describes it"
                )
        except BaseException:
            with self._in_words():
                arm.close()
            raise
        self._arm = arm
        return identity

    def close(self) -> bool:
        """Leave the arm held. Safe to call twice; False if it did not answer."""
        arm, self._arm, self._in_control = self._arm, None, False
        if arm is None:
            return True
        try:
            with self._in_words():
                return arm.close()
        except HardwareError:
            return False

    def snapshot(self) -> ArmSnapshot:
        """Return the latest state, with this program's own STOP latch in it."""
        with self._in_words():
            found = self._there.snapshot()
        return replace(found, stopped=True) if self._latch.latched else found

    def take_control(self) -> None:
        """Enable the drives, holding."""
        self._require_no_stop()
        with self._in_words():
            self._there.take_control()
        self._in_control = True

    def set_modes(self, modes: Sequence[JointMode]) -> None:
        """Ask for one mode per joint, and look whether the arm says so."""
        if len(modes) != len(self._limits):
            raise ValueError(f"{len(self._limits)} joints need as many modes, not {len(modes)}")
        self._require_no_stop()
        self._require_control()
        with self._in_words():
            self._there.set_modes(modes)
            joints = self._there.snapshot().joints
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
        joints = self._there.snapshot().joints
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
                return "STOP"
            try:
                return None if watch is None else watch(snapshot)
            except BaseException as error:
                own.append(error)
                raise

        with self._in_words(own):
            moved = self._there.move(targets_rad, speed_rad_per_s=speed_rad_per_s, watch=watching)
        self._require_no_stop()
        return moved

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
            return self._there.capture(samples)

    def hold(self) -> None:
        """All joints to position mode where they are."""
        self._require_no_stop()
        with self._in_words():
            self._there.hold()

    def stop(self) -> None:
        """Latch, and stop the arm. From any thread."""
        self._latch.press()
        with self._in_words():
            self._there.stop()

    def reset_stop(self) -> None:
        """Clear what the arm latched, then the latch; the drives stay disabled until `take_control`."""
        press = self._latch.last
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

    def _require_no_stop(self) -> None:
        if self._latch.latched:
            raise Stopped("STOP is latched: reset it before anything moves again")

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
