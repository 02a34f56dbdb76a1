"""An open connection to the arm: bus handles, control loop, object access, control token, snapshot."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Final

import can

from hardware import errors
from hardware.arm import ArmSnapshot, DriveState, Fault, JointMode, JointState
from hardware.arm_description import EncoderDescription
from hardware.buses.acceptance_filters import operator_filters, set_hardware_filters
from hardware.buses.python_can import ArmOnBus
from hardware.buses.shared_bus import SharedBus
from hardware.canopen import objects
from hardware.canopen.cia402 import state_of
from hardware.canopen.cyclic import Sample, Setpoints, frames_of
from hardware.canopen.identifying import scales_of
from hardware.canopen.maps import POSITION_AGREEMENT_RAD, check_mapping, check_positions
from hardware.canopen.sdo import ObjectAccess
from hardware.command_limits import admit, arm_limits
from hardware.control import motion_steps, uploading
from hardware.control.alarms import stop_error
from hardware.control.control_loop import ControlLoop
from hardware.control.stop_line import StopLatch, StopLine
from hardware.monitors.following import Dropout
from hardware.monitors.joint_monitor import ENCODER_COUNTS, RVDT_COUNTS, JointMonitor

POSITION_RECHECKS: Final = 3
"""Number of further comparisons if the positions read by PDO and by SDO differ although the maps agree."""


class Connection:
    """Bus handles, control loop and object access of one connection; the constructor opens the bus."""

    def __init__(
        self,
        on_bus: ArmOnBus,
        *,
        record_to: Path | None,
        latch: StopLatch,
        clock: Callable[[], float],
    ) -> None:
        description, settings, profile = on_bus.description, on_bus.settings, on_bus.profile
        timing = on_bus.timing
        self.profile = profile
        self.on_bus, self._timing, self._clock = on_bus, timing, clock
        self.scales = scales_of(description, profile)
        self.limits = arm_limits(description.joints, self.scales)
        self.modes: tuple[JointMode | None, ...] = (None,) * len(profile.joints)
        """6061h of each drive as last read; None if it is neither position nor free."""
        self.token = 0
        """Holder of the control token as last read or written; OPERATOR_NODE may also stand for an earlier operator."""
        self.in_control = self.took_control = False
        """Whether this program is in control now, and whether it was at any time in this connection."""
        self._late_before_control = 0
        self._compares_positions = True
        self.found_powered: dict[int, DriveState] = {}
        """State, by joint, of each drive that had power before the start-up although no operator was heard."""
        self.rated_torques_nm: tuple[float, ...] = (0.0,) * len(profile.joints)
        """Torque of each joint, N m, that its drive reports as 1000 per mille in 6077h."""
        bus = on_bus.open_main(settings)
        if record_to is None:  # a recording needs all frames
            set_hardware_filters(bus, operator_filters(profile))
        self.wire = SharedBus(bus, record_to=record_to, send_timeout_s=timing.tick_s)
        second: can.BusABC | None = None
        try:
            with suppress(errors.BusError):  # the adapter can be opened only once
                second = on_bus.open_stop(settings)
            self.stop_line = StopLine(second, self.wire, frames_of(profile))
        except BaseException:
            self.wire.close()
            raise
        self.access = ObjectAccess(self.wire.send, profile.nodes, timeout_s=timing.sdo_timeout_s)
        self.loop = ControlLoop(
            self.wire,
            on_bus,
            on_sdo=self.access.deliver,
            allow=self._allow,
            quick_stop=self.send_quick_stops,
            watch=JointMonitor(
                [
                    ENCODER_COUNTS if isinstance(joint.sensor, EncoderDescription) else RVDT_COUNTS
                    for joint in description.joints
                ],
                divergence=latch.cause,
            ),
            latch=latch,
            clock=clock,
        )

    def close(self) -> None:
        """Stop sending, shut the bus handles down, and close the recording."""
        self.loop.close()
        self.stop_line.close()
        self.wire.close()

    def other_operator(self) -> bool:
        """Whether another operator's heartbeat is on the bus."""
        return self.loop.nodes.other_operator(self._timing.heartbeat_timeout_s)

    def is_lost(self) -> bool:
        """Whether the bus failed or a node has fallen silent."""
        return self.loop.failure is not None or bool(self.loop.nodes.silent())

    def require_same_maps(self) -> None:
        """Raise `MappingChanged` if the positions in TPDOs differ from those read by SDO (6064h); call this at rest.

        If a node does not answer by SDO, nothing is checked, neither now nor in later calls.
        """
        differs = self._differing_positions()
        if differs is None:
            return
        with suppress(errors.BusError, errors.SdoRefused, errors.DuplicateNodeId):
            try:
                check_mapping(self.access, self.profile)
            except errors.MappingMismatch as why:
                raise errors.MappingChanged(why) from why
        for _ in range(POSITION_RECHECKS):  # noise, or a joint not yet at rest
            spread_rad = [POSITION_AGREEMENT_RAD] * len(self.scales)
            self.loop.run(motion_steps.settle(self, 10, spread_rad, timeout_syncs=100))
            differs = self._differing_positions()
            if differs is None:
                return
        raise errors.MappingChanged(differs)

    def _differing_positions(self) -> errors.MappingMismatch | None:
        """Return the differences between SDO and PDO positions; None if they agree or a node does not answer."""
        counts = self.loop.sample.counts
        try:
            if self._compares_positions:
                check_positions(self.access, self.profile, counts, self.scales)
        except errors.MappingMismatch as differs:
            return differs
        except errors.BusError:  # after three attempts: do not delay every later pose
            self._compares_positions = False
        except (errors.SdoRefused, errors.DuplicateNodeId):
            pass
        return None

    def read_modes(self) -> None:
        """Read 6061h of every drive; `DuplicateNodeId` if a node answers twice."""
        self.modes = tuple(
            self.profile.mode_of(self.access.read_signed(node, objects.MODE_DISPLAY))
            for node in self.profile.drives
        )
        self.access.require_unique_nodes()

    def take_token(self) -> None:
        """Take the control token from the supervisor, if there is one; `ControlDenied` if it refuses."""
        if (supervisor := self.profile.supervisor) is not None:
            try:
                self.access.write_unsigned(supervisor, objects.TOKEN, 0, objects.OPERATOR_NODE, 4)
            except errors.SdoRefused as refused:
                self.token = self.access.read_unsigned(supervisor, objects.TOKEN)
                reason = uploading.refusal(self.access, supervisor)
                raise errors.ControlDenied(self.token, reason) from refused
        self._late_before_control = self.loop.latency.lateness.times
        self.token, self.in_control, self.took_control = objects.OPERATOR_NODE, True, True

    def may_repeat(self, error: errors.HardwareError) -> bool:
        """Return whether an upload may repeat the step that failed with `error`.

        The result is false if the arm is silent, or if this program lost control for a reason other than host latency.
        If host latency is the reason, this method first requests control again.
        """
        if self.is_lost():
            return False
        supervisor = self.profile.supervisor
        lapsed = isinstance(error, errors.SdoRefused) and error.code == objects.Abort.LOCAL_CONTROL
        if not lapsed or not supervisor:
            return True
        if not self.in_control or not self._late_since_control():
            return False
        with suppress(errors.SdoRefused, errors.BusError):  # the next attempt requests it again
            self.access.write_unsigned(supervisor, objects.TOKEN, 0, objects.OPERATOR_NODE, 4)
        return True

    def explain(self, error: errors.HardwareError) -> errors.HardwareError:
        """Return `HostLatencyExceeded` if host latency since control was taken may explain `error`, else `error`."""
        late = self._late_since_control()
        refused = isinstance(error, errors.SdoRefused) and error.code != objects.Abort.LOCAL_CONTROL
        if not late or refused or isinstance(error, errors.DuplicateNodeId | errors.FramesLost):
            return error
        return errors.HostLatencyExceeded(late, self.loop.latency.lateness.last_s)

    def _late_since_control(self) -> int:
        return self.loop.latency.lateness.times - self._late_before_control

    def release_token(self) -> None:
        """Release the control token."""
        if self.profile.supervisor is not None:
            self.access.write_unsigned(self.profile.supervisor, objects.TOKEN, 0, 0, 4)
        self.token, self.in_control = 0, False

    def send_quick_stops(self) -> None:
        """Send quick stop to all drives now."""
        self.stop_line.send(self.loop.commands, self.loop.sample.counts)

    def snapshot(self) -> ArmSnapshot:
        """Return the latest state; never blocks. Speeds are means over `SPEED_SYNCS` control periods."""
        loop, nodes, view = self.loop, self.loop.nodes, self.loop.sampler.view
        divergence = loop.watch.divergence
        # Read after the view, so that no answer in it is later than now_s.
        now_s = self._clock()
        listened_s = loop.latency.listened_s
        sample, earlier = view.sample, view.earlier
        elapsed_s = max(sample.sync_count - earlier.sync_count, 1) * objects.CONTROL_PERIOD_S
        joints = tuple(
            JointState(
                joint=joint + 1,
                position_counts=counts,
                position_rad=scale.to_rad(counts),
                speed_rad_per_s=(counts - earlier.counts[joint]) / scale.counts_per_rad / elapsed_s,
                torque_nm=sample.torques_per_mille[joint] * 1e-3 * self.rated_torques_nm[joint],
                drive=state_of(sample.statuswords[joint]),
                mode=self.modes[joint],
                age_s=now_s - view.answered_at_s[joint],
            )
            for joint, (scale, counts) in enumerate(zip(self.scales, sample.counts, strict=True))
        )
        return ArmSnapshot(
            sync_count=sample.sync_count,
            joints=joints,
            late_s=max(0.0, loop.latency.late_s - min(view.late_at_s, default=0.0)),
            heartbeat_age_s=MappingProxyType(
                {node: listened_s - heard for node, heard in dict(nodes.heard_at_s).items()}
            ),
            token=self.token,
            faults=nodes.faults or tuple(map(self._fault, loop.watch.dropout.dropouts)),
            stopped=loop.latch.latched,
            stopped_for="" if divergence is None else str(stop_error(divergence)),
            moving=loop.moving,
            lateness=loop.latency.lateness,
        )

    def _fault(self, dropout: Dropout) -> Fault:
        joint, text = dropout.joint, f"the drive is in state '{dropout.state.value}'"
        if dropout.not_following:
            text = "the drive does not follow its target"
        node, at = self.profile.drives[joint - 1], dropout.sync_count
        return Fault(node=node, joint=joint, code=0, text=text, sync_count=at)

    def _allow(self, sample: Sample, before: Setpoints | None, commands: Setpoints) -> None:
        admit(
            self.limits,
            self.modes,
            in_control=self.in_control,
            stopped=self.loop.latch.latched,
            sample=sample,
            before=before,
            commands=commands,
        )
