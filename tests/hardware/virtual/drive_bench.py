"""A virtual drive on the bench: what it is told and what it says. No test in it."""

from hardware.arm import DriveState
from hardware.canopen.objects import EmergencyCode
from hardware.virtual.drive import Drive
from tests.oracles.virtual_rig import axes

S, E = DriveState, EmergencyCode
SHUTDOWN, SWITCH_ON, ENABLE, QUICK_STOP, DISABLE, RESET = 0x06, 0x07, 0x0F, 0x02, 0x00, 0x80
CSP, CST = 8, 10
ENCODER = axes()[0]
STEP = ENCODER.limits.max_step_counts


class Bench:
    """A drive with its errors written down; `run` lets control periods pass."""

    def __init__(self, axis=ENCODER, *, counts: int = 100) -> None:  # type: ignore[no-untyped-def]
        self.said: list[EmergencyCode] = []
        self.drive = Drive(
            axis, on_error=self.said.append, on_all_clear=lambda: self.said.append(E.NONE)
        )
        self.counts, self.torque_nm, self.speed = counts, 0.0, 0.0
        self.drive.in_control = True
        self.run()

    def run(self, periods: int = 1) -> None:
        for _ in range(periods):
            self.drive.read(self.counts, self.torque_nm, self.speed)

    def enabled(self, mode: int = CSP) -> Drive:
        for word in (SHUTDOWN, SWITCH_ON, ENABLE):
            self.drive.obey(word, self.counts, mode)
        self.run(4)
        assert self.drive.state is S.OPERATION_ENABLED
        return self.drive
