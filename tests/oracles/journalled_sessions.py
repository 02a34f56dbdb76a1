"""Sessions whose journals hold a calibration: by `run`, by the paper's estimator, by the app, resumed.

Made as the product makes them, on the plant without a bus. The poses are captured once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from operator_app.composition import carried_procedure
from operator_app.headless.runner import run
from operator_app.session.journal import JOURNAL_NAME
from operator_app.session.listener import Listener
from operator_app.session.opening import Choices, Rig, begin, open_session
from operator_app.session.opening import resume as resumed
from operator_app.session.operations import Operations
from operator_app.session.session import Session
from operator_app.session.snapshot import Change, SessionSnapshot
from oracles.plant_arm import PlantArm

POSES = 12
SCENARIO = "datasheet"


class Ticking:
    """A clock that advances one second a reading."""

    def __init__(self) -> None:
        self._now = datetime(2026, 1, 31, 12, 0, 0, tzinfo=UTC)

    def __call__(self) -> datetime:
        self._now += timedelta(seconds=1)
        return self._now


class Quiet:
    """A publisher on which nobody ends anything; `shown` is its picture."""

    def __init__(self, session: Session) -> None:
        self.shown = SessionSnapshot(
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

    def publish(self, change: Change) -> None:
        self.shown = change(self.shown)

    def say(self, level: object, text: str) -> None: ...

    def cancelled(self) -> bool:
        return False


def journalled_sessions(root: Path) -> Mapping[str, Path]:
    """Return session folders below `root` by how they were made."""
    clock = Ticking()
    opening = begin(
        "hinge",
        Choices(poses=POSES, scenario=SCENARIO, interface="virtual"),
        root=root,
        clock=clock,
    )

    def go_on(folder: Path, work: Callable[[Session], object], **chosen: object) -> Path:
        found = opening
        if folder.is_dir():
            found = resumed(str(folder), Choices(**chosen), root=root)  # type: ignore[arg-type]
        procedure = carried_procedure(found)
        rig = Rig(
            arm=PlantArm(procedure, SCENARIO),
            opening=replace(found, folder=folder, procedure=procedure),
            simulated=True,
        )
        session = open_session(rig, clock=clock)
        work(session)
        session.close("done")
        return folder

    def by_run(session: Session) -> None:
        run(session, Listener())

    def by_app(session: Session) -> None:
        operations = Operations(session, Quiet(session))
        operations.connect()
        operations.calibrate("implicit", ())
        operations.write()

    first = go_on(root / "run", by_run)

    def copy(name: str, *, solved: bool) -> Path:
        lines = (first / JOURNAL_NAME).read_text().splitlines(keepends=True)
        end = len(lines) if solved else next(k for k, x in enumerate(lines) if '"solved"' in x)
        (root / name).mkdir()
        (root / name / JOURNAL_NAME).write_text("".join(lines[:end]))
        return root / name

    return {
        "run": first,
        "paper": go_on(copy("paper", solved=False), by_run, estimator="paper"),
        "app": go_on(copy("app", solved=False), by_app),
        "resumed": go_on(copy("resumed", solved=True), by_run),
    }
