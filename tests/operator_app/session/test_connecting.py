"""What is said and journalled as an arm is connected: what was written into its drives, and what they do not watch."""

from dataclasses import replace

from operator_app.session.store.journal import read_journal
from operator_app.session.ui.operations import Operations
from operator_app.session.workflow.capture import connect
from operator_app.session.workflow.listener import Listener
from tests.oracles.journalled_sessions import Quiet
from tests.oracles.opened import MakeSession
from tests.oracles.short_procedure import short_procedure


def test_what_was_written_into_drives_is_said_and_journalled(make_session: MakeSession) -> None:
    session = make_session(short_procedure(12))
    connect_arm = session.arm.connect
    changed = ("joint 1 (node 1): RPDO2 is this", "joint 2 (node 2): RPDO2 is that")
    session.arm.connect = lambda: replace(connect_arm(), configured=changed)
    told: list[str] = []
    listener, publisher = Listener(), Quiet(session)
    listener.report = told.append
    publisher.say = lambda level, text: told.append(f"{level.value}: {text}")
    connect(session, listener)
    assert told[0].startswith(
        "2 PDOs of the drives set up as the bus profile requires, until the next connection or a loss of power: "
    )
    assert "joint 1 (node 1): RPDO2 is this; and so on" in told[0]
    Operations(session, publisher).connect()
    assert any(text.startswith("info: 2 PDOs of the drives set up") for text in told)
    lines = [e for e in read_journal(session.journal.path.parent).events if e.name == "connected"]
    assert [list(changed)] * 2 == [line.data["configured"] for line in lines]


def test_what_was_set_to_zero_in_drives_is_no_pdo(make_session: MakeSession) -> None:
    session = make_session(short_procedure(12))
    connect_arm = session.arm.connect
    pdo, zeroed = "joint 1 (node 1): RPDO2 is this", "joint 2 (node 2): 6071h is 0; it was -50"
    session.arm.connect = lambda: replace(connect_arm(), configured=(pdo, zeroed), zeroed=(zeroed,))
    told: list[str] = []
    listener = Listener()
    listener.report = told.append
    connect(session, listener)
    assert told[0].startswith("1 PDO of the drives set up")
    assert (
        f"1 torque or offset in the drives set to 0, not restored afterwards: {zeroed}." in told[0]
    )


def test_a_drive_that_does_not_say_that_it_misses_its_operator_is_named(
    make_session: MakeSession,
) -> None:
    session = make_session(short_procedure(12))
    connect_arm = session.arm.connect
    session.arm.connect = lambda: replace(connect_arm(), unwatching=(3, 5))
    told: list[str] = []
    listener, publisher = Listener(), Quiet(session)
    listener.report = told.append
    publisher.say = lambda level, text: told.append(f"{level.value}: {text}")
    connect(session, listener)
    assert told[0].startswith("Joints 3, 5: the drives have no heartbeat timeout (1016h)")
    assert "hardware stop" in told[0]
    told.clear()
    Operations(session, publisher).connect()
    assert any(
        text.startswith("warning: Joints 3, 5: the drives have no heartbeat") for text in told
    )
