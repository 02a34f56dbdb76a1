"""Session folders with a calibration, on the plant without a bus; their poses are captured once."""

from dataclasses import replace
from pathlib import Path

from operator_app.commands.run import run
from operator_app.session.store.journal import JOURNAL_NAME, Clock, utc_now
from operator_app.session.ui.operations import Operations
from operator_app.session.ui.snapshot import Change, Level, SessionSnapshot
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.opening import Choices, Opening, Rig, begin, open_session, resume
from operator_app.session.workflow.session import Session
from tests.oracles.plant_arm import PlantArm
from tests.oracles.plant_sessions import TickingClock

POSES = 12
SCENARIO = "datasheet"


def initial_snapshot(session: Session) -> SessionSnapshot:
    return SessionSnapshot(
        now_s=0.0,
        procedure=session.procedure,
        folder=session.journal.path.parent,
        state=session.state,
        simulated=True,
        bus="",
        mobility=2,
        estimator="implicit",
        unsensed_joints=(),
    )


class Quiet:
    """A publisher without cancellation; `shown` is its snapshot, `messages` with their levels."""

    def __init__(self, session: Session) -> None:
        self.shown = initial_snapshot(session)
        self.messages: list[tuple[Level, str]] = []
        self.snapshot = lambda: self.shown

    def publish(self, change: Change) -> None:
        self.shown = change(self.shown)

    def say(self, level: Level, text: str) -> None:
        self.messages.append((level, text))

    def cancelled(self) -> bool:
        return False


def resume_on_plant(folder: Path, clock: Clock = utc_now, **chosen: object) -> Session:
    opening = resume(str(folder), Choices(**chosen), root=folder.parent)  # type: ignore[arg-type]
    return _session(opening, clock)


def _session(opening: Opening, clock: Clock) -> Session:
    procedure = opening.effective_procedure
    rig = Rig(
        arm=PlantArm(procedure, SCENARIO),
        opening=replace(opening, procedure=procedure),
        simulated=True,
    )
    return open_session(rig, clock=clock)


def journalled_sessions(root: Path) -> None:
    """Create the session folders, named by their origin."""
    clock, folder = TickingClock(), root / "run"
    choices = Choices(poses=POSES, scenario=SCENARIO, interface="virtual")
    _by_run(
        _session(replace(begin("hinge", choices, root=root, clock=clock), folder=folder), clock)
    )
    lines = (folder / JOURNAL_NAME).read_text().splitlines(keepends=True)
    captured = next(k for k, line in enumerate(lines) if '"solved"' in line)

    def copy(name: str, count: int, **chosen: object) -> Session:
        (root / name).mkdir()
        (root / name / JOURNAL_NAME).write_text("".join(lines[:count]))
        return resume_on_plant(root / name, clock, **chosen)

    _by_run(copy("paper", captured, estimator="paper"))
    _by_app(copy("app", captured))
    _by_run(copy("resumed", len(lines)))


def _by_run(session: Session) -> None:
    run(session, Listener())
    session.close("done")


def _by_app(session: Session) -> None:
    operations = Operations(session, Quiet(session))
    operations.connect()
    operations.calibrate("implicit", ())
    operations.write()
    session.close("done")
