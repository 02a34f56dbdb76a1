"""Sessions on live fake arms, for tests of both faces."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.session.desk import Desk
from operator_app.session.folder import SessionEntry, list_sessions
from operator_app.session.journal import Journal
from operator_app.session.workflow import Session
from oracles.live_arm import LiveArm


def quick_procedure(poses: int = 6) -> Procedure:
    """The packaged hinge procedure with few poses and a limit that few poses meet."""
    procedure = load_procedure("hinge")
    return replace(
        procedure,
        capture=replace(procedure.capture, poses=poses, samples_per_pose=8),
        acceptance=replace(procedure.acceptance, scaled_condition_number=400.0),
    )


class FakeSource:
    """A `Source` of sessions on live fake arms. `arm` is the present one."""

    def __init__(self, root: Path, *, poses: int = 6, simulated: bool = True) -> None:
        self.root, self.simulated = root, simulated
        self.procedure = quick_procedure(poses)
        self.pace_s = 0.0
        self.serial = "SDA-0001"
        self.arm: LiveArm | None = None
        self.desk: Desk | None = None
        self._made = 0

    def new(self, procedure: str | None = None) -> Desk:
        """Begin."""
        self.close("another session was begun")
        if procedure is not None:
            self.procedure = load_procedure(procedure)
        self._made += 1
        return self._open(Journal.create(self.root / f"session-{self._made}"), begun=False)

    def procedures(self) -> tuple[Procedure, ...]:
        """What there is to choose from."""
        return (self.procedure, load_procedure("hinge_planned"))

    def resumed(self, reference: str) -> Desk:
        """Go on."""
        self.close("another session was resumed")
        return self._open(Journal.resume(self.root / reference), begun=True)

    def sessions(self) -> tuple[SessionEntry, ...]:
        """Newest first."""
        return list_sessions(self.root)[::-1]

    def close(self, reason: str) -> None:
        """Close."""
        desk, self.desk = self.desk, None
        if desk is not None:
            desk.close(reason)

    def _open(self, journal: Journal, *, begun: bool) -> Desk:
        self.arm = LiveArm(self.procedure, pace_s=self.pace_s, serial=self.serial)
        session = Session(journal=journal, arm=self.arm, procedure=self.procedure)
        if not begun:
            session.open(sources={}, settings={})
        self.desk = Desk(session, simulated=self.simulated, bus="a fake bus")
        return self.desk
