"""Behaviour of one drive: states, modes, limits, trips.

Time is counted in control periods. `command` returns the joint's command for the next period, and `read` takes in the
sensor values at the end of that period.
"""

from collections.abc import Callable

from hardware.arm import DriveState, JointMode
from hardware.canopen import cia402
from hardware.canopen.cia402 import DriveEvent, StatusBit
from hardware.canopen.objects import JOINT_MODE, EmergencyCode
from hardware.command_limits import refuse_target
from hardware.virtual.axis import AxisSettings, JointCommand


class Drive:
    """A CiA 402 axis in cyclic position or cyclic torque mode.

    After a quick stop or the loss of the operator's heartbeat the drive holds the measured position in position mode.
    After any other trip the joint's valve is blocked.

    `faults`: names of the active faults (`hardware.virtual.faults`).
    `on_emergency` is called with the active errors, the latest last, at every new error and once no error is left.
    """

    def __init__(
        self,
        axis: AxisSettings,
        faults: set[str],
        *,
        on_emergency: Callable[[list[EmergencyCode]], None],
    ) -> None:
        self.axis, self._faults, self._on_emergency = axis, faults, on_emergency
        self.counts = 0
        self.torque_nm = 0.0
        self.speed_rad_per_s = 0.0
        self.in_control = False
        self.power_up()

    def power_up(self) -> None:
        """Set the state after power-up; errors are cleared without an emergency message."""
        self.state = cia402.after_event(DriveState.NOT_READY_TO_SWITCH_ON, DriveEvent.INITIALISED)
        self.errors: list[EmergencyCode] = []
        self.controlword = 0
        self.mode_request = 0
        self.mode: JointMode | None = None
        self.target_counts = self.counts
        self._holding = False
        self._switching_for = 0
        self._torque_for = 0
        self._following_for = 0
        self._command: JointCommand | None = None

    def obey(self, controlword: int, target_counts: int, mode_code: int) -> None:
        """Act on the values of an RPDO1: first the controlword, then the mode, then the target."""
        self.obey_controlword(controlword)
        self.ask_for_mode(mode_code)
        self.obey_target(target_counts)

    def obey_controlword(self, controlword: int) -> None:
        """Act on 6040h; only transitions towards motion need the control token."""
        self.finish_reaction()
        before = self.state
        after = cia402.after_controlword(before, controlword, self.controlword)
        self.controlword = controlword
        if after is before:
            return
        if before is DriveState.FAULT and not self._reset():
            return
        if cia402.raises_power(before, after) and not self.in_control:
            return
        self._command = None
        self.state = after
        if after is DriveState.QUICK_STOP_ACTIVE:
            self._hold()
        elif after is DriveState.OPERATION_ENABLED:
            self._set_target_to_position()
        else:
            self._holding = False
            self._end(EmergencyCode.REFERENCE_LIMIT)

    def ask_for_mode(self, mode_code: int) -> None:
        """Request a mode (6060h); the drive changes to this mode (6061h) a few control periods later."""
        if mode_code != self.mode_request:
            self.mode_request = mode_code
            self._switching_for = 0

    def obey_target(self, target_counts: int) -> None:
        """Act on 607Ah if the drive is enabled, in position mode and under control."""
        if "deaf-drive" in self._faults or not (self._is_servo_on and self.in_control):
            return
        if target_counts == self.target_counts:
            self._end(EmergencyCode.REFERENCE_LIMIT)
        elif not refuse_target(self.axis.limits, target_counts, self.target_counts):
            self.target_counts = target_counts
            self._command = None
            self._end(EmergencyCode.REFERENCE_LIMIT)
        else:
            self._begin(EmergencyCode.REFERENCE_LIMIT)

    def quick_stop(self) -> None:
        """If the drive is enabled, stop and hold without a controlword."""
        after = cia402.after_event(self.state, DriveEvent.QUICK_STOP)
        if after is not self.state:
            self.state = after
            self._hold()

    def lose_heartbeat(self) -> None:
        """Put this drive into the fault state because the heartbeat of the node in control is missing.

        A drive with power holds its position until the fault is reset. If no node is in control, nothing happens.
        """
        known = EmergencyCode.HEARTBEAT_LOST in self.errors
        if "unwatched" in self._faults or known or not self.in_control:
            return
        if self.state in cia402.POWERED_STATES:
            self._hold()
        self.trip(EmergencyCode.HEARTBEAT_LOST, holding=self._holding)

    def trip(self, code: EmergencyCode, *, holding: bool = False) -> None:
        """Enter the fault state; with `holding` the servo holds the joint, otherwise the valve is blocked."""
        self._holding = holding
        self._command = None
        self.state = cia402.after_event(self.state, DriveEvent.FAULT)
        self._begin(code)

    def finish_reaction(self) -> None:
        """Change from *fault reaction active* to *fault*; no effect in other states."""
        self.state = cia402.after_event(self.state, DriveEvent.FAULT_REACTION_DONE)

    def command(self) -> JointCommand:
        """Return the joint's command for the next control period."""
        if self._command is None:
            enabled = self.state is DriveState.OPERATION_ENABLED
            servo = self._holding or self._is_servo_on
            mode = JointMode.POSITION if servo else self.mode if enabled else None
            target_counts = self.target_counts if servo else self.counts
            self._command = mode, self.axis.scale.to_rad(target_counts)
        return self._command

    def read(self, counts: int, torque_nm: float, speed_rad_per_s: float) -> None:
        """Take in sensor values after a control period; then switch modes and check for faults."""
        self.finish_reaction()
        if "lost-enable" in self._faults and self.state is DriveState.OPERATION_ENABLED:
            self._faults.remove("lost-enable")
            self.state, self._command = DriveState.SWITCHED_ON, None
        self.counts, self.torque_nm, self.speed_rad_per_s = counts, torque_nm, speed_rad_per_s
        self._switch_mode()
        self._supervise()

    @property
    def _is_servo_on(self) -> bool:
        return self.state is DriveState.OPERATION_ENABLED and self.mode is JointMode.POSITION

    @property
    def statusword(self) -> int:
        """6041h."""
        flags = int(StatusBit.VOLTAGE_ENABLED)
        if self.in_control:
            flags |= StatusBit.REMOTE
        if EmergencyCode.REFERENCE_LIMIT in self.errors:
            flags |= StatusBit.INTERNAL_LIMIT
        if self._is_servo_on and "deaf-drive" not in self._faults:
            flags |= StatusBit.FOLLOWS_COMMAND
        if EmergencyCode.FOLLOWING in self.errors:
            flags |= StatusBit.FOLLOWING_ERROR
        return cia402.statusword(self.state, flags)

    def _hold(self) -> None:
        self._holding = True
        self._set_target_to_position()
        self.mode = JointMode.POSITION

    def _set_target_to_position(self) -> None:
        """Set the measured position as the target, so that no old target causes motion."""
        self.target_counts = self.counts
        self._torque_for = self._following_for = 0
        self._command = None

    def _switch_mode(self) -> None:
        mode = JOINT_MODE.get(self.mode_request)
        switching = mode not in (None, self.mode) and not self._holding
        self._switching_for = self._switching_for + 1 if switching else 0
        refused = "refused-modes" in self._faults
        if self._switching_for >= self.axis.mode_switch_cycles and not refused:
            self.mode, self._switching_for = mode, 0
            self._set_target_to_position()

    def _supervise(self) -> None:
        axis = self.axis
        inside = axis.lowest_counts < self.counts < axis.highest_counts
        if "broken-sensor" in self._faults or not inside:
            self._trip_once(EmergencyCode.SENSOR)
        if not (self.state in cia402.POWERED_STATES or self._holding):
            return
        if abs(self.speed_rad_per_s) > axis.limits.max_speed_rad_per_s:
            self._trip_once(EmergencyCode.OVERSPEED)
        excess = abs(self.torque_nm) > axis.max_torque_nm
        self._torque_for = self._torque_for + 1 if excess else 0
        if self._torque_for >= axis.trip_cycles:
            self._trip_once(EmergencyCode.EXCESS_TORQUE)
        if self.mode is not JointMode.POSITION or "stray" in self._faults:
            return
        away = abs(self.counts - self.target_counts) > axis.following_window_counts
        self._following_for = self._following_for + 1 if away else 0
        if self._following_for >= axis.trip_cycles:
            self._trip_once(EmergencyCode.FOLLOWING)

    def _trip_once(self, code: EmergencyCode) -> None:
        if code not in self.errors:
            self.trip(code)

    def _reset(self) -> bool:
        persists = {
            EmergencyCode.EXTERNAL_STOP: "external-stop" in self._faults,
            EmergencyCode.SENSOR: "broken-sensor" in self._faults,
        }
        if any(persists.get(code, False) for code in self.errors):
            return False
        cleared, self.errors = self.errors, []
        if cleared:
            self._on_emergency([])
        return True

    def _begin(self, code: EmergencyCode) -> None:
        if code not in self.errors:
            self.errors.append(code)
            self._on_emergency(self.errors)

    def _end(self, code: EmergencyCode) -> None:
        if code in self.errors:
            self.errors.remove(code)
            if not self.errors:
                self._on_emergency([])
