"""`load_result`: the calibration of a session back into a program, as its journal has it."""

from __future__ import annotations

from os import PathLike, fspath
from pathlib import Path

from operator_app.effective_procedure import effective_procedure
from operator_app.errors import SessionError
from operator_app.session.store.folders import read_session
from operator_app.session.store.stored_calibration import session_calibration
from operator_app.session.workflow.opening import Choices, resume

from .blas_threads import one_blas_thread
from .given import shown
from .machines import Arm, Fixture
from .poses import Poses
from .result import Journalled, Result

SESSIONS = Path("sessions")
"""Where sessions are that are called by their name."""


@one_blas_thread
def load_result(session: str | PathLike[str]) -> Result:
    """Read the calibration of a session that ``sarcal run``, ``sarcal import`` or `Result.save` made.

    Nothing is solved again, but for sessions of versions that kept no solution.

    Parameters
    ----------
    session
        Its folder; its name, or ``latest``, below ``sessions``.

    Raises
    ------
    TypeError
        It is no path.
    SessionError
        There is no session, it cannot be read, or it has no pose that counts.
    SolverError, FixtureError
        It has to be solved after all, and its poses cannot give what is asked for.

    Examples
    --------
    >>> import tempfile
    >>> import sarcal
    >>> made = sarcal.simulate(arm="sarcos_dextrous", fixture="hinge", poses=30, seed=0)
    >>> result = sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=made.poses)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     again = sarcal.load_result(result.save(folder))
    >>> again.values == result.values
    True
    >>> sarcal.compare(result, again).drifted
    ()
    """
    if not isinstance(session, str | PathLike):
        raise TypeError(f"session={shown(session)}: give the folder of a session, or its name")
    opening = resume(fspath(session), Choices(), root=SESSIONS)
    state, procedure = read_session(opening.folder).state, effective_procedure(opening)
    if state is None:
        raise SessionError(f"{opening.folder} holds no session", "name another folder")
    found = session_calibration(state, procedure)
    _, arm, fixture, _ = procedure.sources
    return Result(
        arm=Arm(procedure.arm.name, arm.file, procedure.arm, arm),
        fixture=Fixture(
            procedure.fixture.name, procedure.fixture.kind, fixture.file, procedure.fixture, fixture
        ),
        poses=Poses(str(opening.folder), state.pose_set()),
        solution=found.solution,
        checks=found.checks,
        origin=Journalled(folder=opening.folder, state=state, procedure=procedure),
    )
