"""Whatever arrives at a drive, in whatever order, it goes only where it was allowed to."""

import math

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from hardware.arm import JointMode
from tests.hardware.virtual.drive_bench import STEP, Bench, E, S


class AnyDrive(RuleBasedStateMachine):
    """Whatever arrives and happens, a powered drive only ever goes where it was allowed to."""

    def __init__(self) -> None:
        super().__init__()
        self.bench = Bench()
        self.last_target = self.bench.drive.target_counts

    @rule(
        word=st.sampled_from([0x00, 0x02, 0x06, 0x07, 0x0F, 0x80, 0x8F]) | st.integers(0, 0xFFFF),
        aim=st.integers(-7000, 7000) | st.integers(60, 140),
        mode=st.sampled_from([0, 1, 8, 10]),
    )
    def rpdo(self, word: int, aim: int, mode: int) -> None:
        self.bench.drive.obey(word, aim, mode)

    @rule(torque=st.sampled_from([0.0, 50.0, 120.0]), drift=st.integers(-20, 20))
    def period(self, torque: float, drift: int) -> None:
        command = self.bench.drive.command()
        if command.mode is JointMode.POSITION:
            self.bench.counts = round(command.target_rad * 36000 / math.tau)
        elif command.mode is JointMode.FREE:
            self.bench.counts += drift
        self.bench.torque_nm = torque
        self.bench.run()

    @rule(token=st.booleans())
    def token(self, token: bool) -> None:
        self.bench.drive.in_control = token
        if not token:
            self.bench.drive.quick_stop()

    @rule()
    def heartbeat_lost(self) -> None:
        self.bench.drive.lose_heartbeat()

    @rule()
    def neighbour_tripped(self) -> None:
        self.bench.drive.quick_stop()

    @invariant()
    def nothing_moves_unless_enabled_or_holding(self) -> None:
        drive, command = self.bench.drive, self.bench.drive.command()
        if command.mode is JointMode.FREE:
            assert drive.state is S.OPERATION_ENABLED
        if drive.state in (S.SWITCH_ON_DISABLED, S.READY_TO_SWITCH_ON, S.SWITCHED_ON):
            assert command.mode is None

    @invariant()
    def targets_move_by_allowed_steps_from_where_the_joint_was(self) -> None:
        drive = self.bench.drive
        jump = abs(drive.target_counts - self.last_target)
        assert jump <= STEP or drive.target_counts == drive.counts
        self.last_target = drive.target_counts

    @invariant()
    def errors_and_state_agree(self) -> None:
        drive = self.bench.drive
        in_fault = drive.state in (S.FAULT, S.FAULT_REACTION_ACTIVE)
        # A refused target is no fault.
        assert bool(set(drive.errors) - {E.REFERENCE_LIMIT}) == in_fault
        assert len(drive.errors) == len(set(drive.errors))
        if drive.errors:
            assert self.bench.said[-1] is not E.NONE


TestAnyDrive = AnyDrive.TestCase
TestAnyDrive.settings = settings(max_examples=60, stateful_step_count=40)
