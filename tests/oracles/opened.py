"""A session on a test's own arm."""

from collections.abc import Callable
from pathlib import Path

from hardware.arm import ArmInterface
from operator_app.config.procedure import Procedure
from operator_app.session.store.journal import Clock, utc_now
from operator_app.session.workflow.opening import Choices, Opening, Rig, open_session
from operator_app.session.workflow.session import Session

MakeSession = Callable[..., Session]
"""Type of the fixture `make_session`."""


def opened(
    folder: Path,
    arm: ArmInterface,
    procedure: Procedure,
    *,
    resumed: bool = False,
    clock: Clock = utc_now,
) -> Session:
    opening = Opening(
        folder=folder, resumed=resumed, procedure=procedure, choices=Choices(), sources={}
    )
    return open_session(Rig(arm=arm, opening=opening, simulated=True), clock=clock)
