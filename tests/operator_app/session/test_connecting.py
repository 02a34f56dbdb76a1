"""What is said and journalled as an arm is connected: what was written into its drives, and what they do not watch."""

from dataclasses import replace
from typing import Any

import pytest

from operator_app.session.store.journal import read_journal
from operator_app.session.ui.operations import Operations
from operator_app.session.ui.snapshot import Level
from operator_app.session.workflow.capture import connect
from tests.oracles.approved import Approve
from tests.oracles.hearing import Hearing
from tests.oracles.journalled_sessions import Quiet
from tests.oracles.opened import MakeSession
from tests.oracles.short_procedure import short_procedure

PDO, ZEROED = "joint 1 (node 1): RPDO2 is this", "joint 2 (node 2): 6071h is 0; it was -50"


@pytest.mark.parametrize(
    ("found", "level"),
    [
        pytest.param({"configured": (PDO, PDO)}, Level.INFO, id="PDOs"),
        pytest.param({"configured": (PDO, ZEROED), "zeroed": (ZEROED,)}, Level.INFO, id="zeroed"),
        pytest.param({"unwatching": (3, 5)}, Level.WARNING, id="no heartbeat timeout"),
    ],
)
def test_what_is_found_in_drives_is_said_on_every_interface_and_journalled(
    make_session: MakeSession, found: dict[str, Any], level: Level, approve: Approve
) -> None:
    session = make_session(short_procedure(12))
    connect_arm = session.arm.connect
    session.arm.connect = lambda: replace(connect_arm(), **found)
    hearing, publisher = Hearing(), Quiet(session)
    connect(session, hearing)
    approve(hearing.said[0])
    Operations(session, publisher).connect()
    assert (level, hearing.said[0].removesuffix(".")) in publisher.said
    lines = [e for e in read_journal(session.journal.path.parent).events if e.name == "connected"]
    configured = list(found.get("configured", ()))
    assert [configured] * 2 == [line.data.get("configured", []) for line in lines]
