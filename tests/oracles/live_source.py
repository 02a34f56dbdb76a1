"""Sessions on live fake arms, for tests of both user interfaces."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.session.ui.runner import Runner
from operator_app.session.ui.sessions import Sessions
from operator_app.session.workflow.opening import Choices, Opening, Rig
from tests.oracles.live_arm import LiveArm


def quick_procedure() -> Procedure:
    """The packaged hinge procedure with few poses, and an acceptance limit for them."""
    procedure = load_procedure("hinge")
    return replace(
        procedure,
        capture=replace(procedure.capture, poses=6, samples_per_pose=8),
        acceptance=replace(procedure.acceptance, scaled_condition_number=400.0),
    )


class FakeSessions(Sessions):
    """Sessions on live fake arms, in folders session-1, session-2, ...; `arm` is the current one."""

    def __init__(self, root: Path) -> None:
        super().__init__("hinge", Choices(), root=root, join=self._joined)
        self.root, self.simulated = root, True
        self.procedure = quick_procedure()
        self.pace_s = 0.0
        self.serial = "SDA-0001"
        self.arm: LiveArm | None = None
        self._made = 0

    @property
    def runner(self) -> Runner | None:
        return self._runner

    @contextmanager
    def _joined(self, opening: Opening) -> Iterator[Rig]:
        procedure, folder = opening.procedure, opening.folder
        if not opening.resumed:
            self._made += 1
            folder = self.root / f"session-{self._made}"
        if procedure.name == self.procedure.name:
            procedure = self.procedure
        self.arm = LiveArm(procedure, pace_s=self.pace_s, serial=self.serial)
        test_opening = replace(opening, folder=folder, procedure=procedure)
        yield Rig(arm=self.arm, opening=test_opening, simulated=self.simulated)
