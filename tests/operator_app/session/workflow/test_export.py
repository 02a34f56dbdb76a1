"""A calibration goes to the controller if it is accepted, or for a reason that is kept; the journal says so."""

import errno
import os
from dataclasses import replace

import pytest

from hardware.errors import BusError, UploadUnknown
from operator_app.config.parameters_file import load_parameters
from operator_app.config.poses_file import load_poses
from operator_app.config.procedure import Procedure
from operator_app.errors import GuardError, JournalError
from operator_app.headless.procedure_run import run
from operator_app.report.results.session import session_text
from operator_app.session.store.journal import read_journal
from operator_app.session.ui.operations import Operations
from operator_app.session.workflow.export import export, recorded_export
from operator_app.session.workflow.listener import Listener
from tests.oracles.journalled_sessions import Quiet
from tests.oracles.short_procedure import short_procedure


@pytest.mark.sample(1)
@pytest.mark.parametrize("silent", ["upload_parameters", "active_parameters"])
def test_an_upload_of_which_nobody_knows_the_outcome_is_in_the_journal(
    make_session, monkeypatch, silent
):
    """The controller may have it: that nothing was written and nothing uploaded would be wrong."""
    session = make_session(short_procedure(8))

    def lost(*_: object) -> None:
        raise (UploadUnknown if silent == "upload_parameters" else BusError)("lost at the commit")

    monkeypatch.setattr(session.arm, silent, lost)
    with pytest.raises(UploadUnknown, match="lost at the commit"):
        run(session, Listener(), forced="a test of the upload")
    session.close("failed")
    told = session.state.exported
    assert told["uploaded"] is None
    assert "lost at the commit" in told["unknown"]
    folder = session.journal.path.parent
    assert [e.name for e in read_journal(folder).events][-2:] == ["exported", "closed"]
    assert "Controller  not known: " in session_text(folder, session.state, accepted=True)


@pytest.mark.parametrize(
    ("lost", "told"),
    [
        (True, "lost at the commit. Then: cannot write"),
        (False, "the parameters were uploaded to slot A and read back. Then: cannot write"),
    ],
)
def test_what_the_controller_was_given_is_said_without_a_journal(
    make_session, monkeypatch, lost, told
):
    session = make_session(short_procedure(8))
    write = os.write

    def full(descriptor: int, data: bytes) -> int:
        if b'"exported"' in data:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(descriptor, data)

    def unknown(*_: object) -> None:
        raise UploadUnknown("lost at the commit")

    monkeypatch.setattr(os, "write", full)
    if lost:
        monkeypatch.setattr(session.arm, "upload_parameters", unknown)
    with pytest.raises(JournalError) as met:
        run(session, Listener(), forced="a test of the upload")
    session.close("failed")
    assert met.value.happened == f"{told} {session.journal.path}: No space left on device"
    assert str(met.value).startswith(f"{met.value.happened}. Free space")


def strict(procedure: Procedure) -> Procedure:
    """A procedure whose limits no arm meets."""
    return replace(procedure, acceptance=replace(procedure.acceptance, sigma_pos_mm=1e-6))


def test_what_is_not_accepted_is_exported_for_a_reason_only_and_the_reason_is_kept(make_session):
    session = make_session(strict(short_procedure(5)))
    result = run(session, Listener())
    assert not result.solution.accepted
    assert result.exported is None
    # Whoever is not content with the result wants the poses.
    kept = load_poses(session.journal.path.parent / "poses.csv", joint_count=7).poses
    assert kept.sha256() == session.state.pose_set().sha256()
    with pytest.raises(GuardError, match=r"was not accepted: .*sigma_pos") as refused:
        export(session, result.solution, upload_too=True)
    assert "--force" in refused.value.remedy
    assert session.arm.active_parameters() == b""
    assert not session.state.exported

    forced = run(session, Listener(), forced="the demo\nis tonight")
    assert forced.exported is not None
    assert session.state.exported["forced"] == "the demo\nis tonight"
    document = load_parameters(forced.exported.parameters)
    assert document.warnings[0].code == "FORCED"
    assert document.warnings[0].text.endswith("exported because: the demo is tonight")
    assert "sigma_pos" in document.warnings[0].text
    assert session.arm.active_parameters() == forced.exported.parameters.read_bytes()


def test_what_is_accepted_needs_no_reason_and_keeps_none(make_session):
    session = make_session(short_procedure(20))
    result = run(session, Listener(), forced="just in case")
    assert result.solution.accepted
    assert result.exported is not None
    assert session.state.exported["forced"] == ""
    codes = [w.code for w in load_parameters(result.exported.parameters).warnings]
    assert "FORCED" not in codes


def test_resuming_shows_the_export_if_file_and_controller_still_have_it(make_session):
    procedure = short_procedure(5)
    session = make_session(procedure)
    run(session, Listener(), forced="a test of the export")
    session.close("done")

    resumed = make_session(procedure, arm=session.arm, resume=True)
    publisher = Quiet(resumed)
    Operations(resumed, publisher).connect()
    exported, receipt = publisher.shown.written, publisher.shown.receipt
    assert exported is not None
    assert receipt is not None
    assert exported.parameters.name == "parameters.yaml"
    assert receipt.length == len(exported.parameters.read_bytes())
    resumed.close("done")

    other_controller = make_session(procedure, resume=True, connect=True)
    export_there = recorded_export(other_controller)
    assert export_there is not None
    assert export_there.receipt is None
    exported.parameters.write_text("changed")
    assert recorded_export(other_controller) is None
