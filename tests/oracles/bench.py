"""Sessions over the bus of this process with one virtual controller, and the true values of its arm."""

import itertools
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from fixtures.measured import Measured
from hardware.buses.python_can import BusSettings
from hardware.virtual.controller import VirtualController
from hardware.virtual.embedded_bus import attended_opener
from operator_app.calibration.result import Solution
from operator_app.calibration.verification import VerificationResult
from operator_app.commands.run import RunResult, run
from operator_app.session.store.stored_calibration import session_calibration
from operator_app.session.workflow.capture import verify
from operator_app.session.workflow.drive_selection import drives_of
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.opening import Choices, Rig, begin, open_session, resume
from operator_app.session.workflow.session import Session
from operator_app.virtual_arms import run_controller, virtual_arm, virtual_instrument
from solver.loops.closure import ClosureModel
from solver.loops.endpoints import MeasuredClosure
from tests.oracles.fast_arm import fast_arm
from tests.oracles.planted_values import planted_values

PATIENCE_S = 10.0
_channels = itertools.count()


class Bench:
    def __init__(
        self, controller: VirtualController, settings: BusSettings, root: Path, **chosen: object
    ) -> None:
        self.controller, self.settings, self.root = controller, settings, root
        self._chosen = chosen
        self._count = 0

    @contextmanager
    def session(self, earlier: Path | None = None, **chosen: object) -> Iterator[Session]:
        self._count += 1
        if earlier is None:
            name, choices = str(self._chosen["procedure"]), _choices(**{**self._chosen, **chosen})
            opening = begin(name, choices, root=self.root)
            opening = replace(opening, folder=self.root / f"session-{self._count}")
        else:
            opening = resume(str(earlier), Choices(), root=self.root)
        opening = replace(opening, procedure=opening.effective_procedure)
        procedure, opener = opening.procedure, attended_opener(self.controller)
        arm = fast_arm(
            procedure.arm, self.settings, procedure.profile, patience_s=PATIENCE_S, open_main=opener
        )
        fixture = procedure.fixture.fixture
        instrument = None
        if isinstance(fixture, Measured) and self.controller.tracker is not None:
            instrument = virtual_instrument(self.controller.tracker, fixture)
        rig = Rig(arm=arm, opening=opening, simulated=True, instrument=instrument)
        session = open_session(rig)
        try:
            yield session
        finally:
            session.close("done")

    def calibrated(self) -> RunResult:
        with self.session() as session:
            return run(session, Listener())

    def verified(self, folder: Path, poses: int = 4) -> VerificationResult:
        with self.session(folder) as session:
            session.connect()
            session.set_modes(drives_of(session))
            solution = session_calibration(session.state, session.procedure).solution
            result, _ = verify(session, solution, poses, Listener())
            return result

    def planted(self, solution: Solution) -> np.ndarray:
        choices = _choices(**self._chosen)
        procedure = begin(str(self._chosen["procedure"]), choices, root=self.root).procedure
        truth = virtual_arm(procedure.arm, procedure.fixture, choices).true_loop()
        values = planted_values(truth, si=True)
        if isinstance(truth.loop, MeasuredClosure):
            values |= _places(truth.loop, solution.model)
        return np.array([values[parameter.name] for parameter in solution.estimate.parameters])


def _places(truth: MeasuredClosure, model: ClosureModel) -> dict[str, float]:
    """True positions of base and target, and their rotations from the solution's nominal ones."""
    assert isinstance(model, MeasuredClosure)
    values: dict[str, float] = {}
    for name, point, true, nominal in (
        ("base", truth.base_m, truth.base_rotation, model.base_rotation),
        ("tip", truth.tip_m, truth.tip_rotation, model.tip_rotation),
    ):
        rotation = Rotation.from_matrix(true @ nominal.T).as_rotvec()
        for axis, position, angle in zip("xyz", point, rotation, strict=True):
            values |= {f"{name}_{axis}": float(position), f"{name}_r{axis}": float(angle)}
    return values


def _choices(procedure: object = None, **chosen: object) -> Choices:
    return Choices(interface="virtual", **chosen)  # type: ignore[arg-type]


@contextmanager
def bench(root: Path, **chosen: object) -> Iterator[Bench]:
    """A controller for the arm and fixture of ``procedure``; other options as in `Choices`."""
    settings = BusSettings(channel=f"bench-{os.getpid()}-{next(_channels)}")
    choices = _choices(**chosen)
    procedure = begin(str(chosen["procedure"]), choices, root=root).procedure
    with run_controller(
        procedure.arm,
        choices,
        settings,
        fixture=procedure.fixture,
        heartbeat_timeout_s=PATIENCE_S,
        attended=True,
    ) as controller:
        yield Bench(controller, settings, root, **chosen)
