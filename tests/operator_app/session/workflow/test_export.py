"""Export of accepted and forced calibrations to the controller, and its journal entries."""

import errno
import os
from dataclasses import replace

import pytest

from hardware.errors import BusError, UploadRefused, UploadUnknown
from operator_app.commands.run import run
from operator_app.config.parameters_file import load_parameters
from operator_app.config.poses_file import load_poses
from operator_app.errors import ConnectAgainError, GuardError, JournalError
from operator_app.report.results.session import session_text
from operator_app.session.ui.operations import Operations
from operator_app.session.workflow.export import export, recorded_export
from operator_app.session.workflow.listener import Listener
from tests.oracles.journal_events import journal_events
from tests.oracles.journalled_sessions import Quiet
from tests.oracles.plant_sessions import short_procedure


def failing(error: type[BaseException]):
    def method(*_: object) -> None:
        raise error("lost at the commit")

    return method


@pytest.mark.sample(2)
@pytest.mark.parametrize(
    ("method", "error", "unknown"),
    [
        ("upload_parameters", UploadUnknown, "lost at the commit"),
        ("active_parameters", BusError, "lost at the commit"),
        ("active_parameters", KeyboardInterrupt, "the upload was interrupted"),
        ("upload_parameters", UploadRefused, ""),  # the previous parameters stay active
    ],
)
def test_upload_without_receipt_is_journalled(make_session, monkeypatch, method, error, unknown):
    """If the controller may have the parameters, neither "uploaded" nor "not uploaded" is known."""
    session = make_session(short_procedure(8))
    monkeypatch.setattr(session.arm, method, failing(error))
    raised = UploadUnknown if error is BusError else error
    with pytest.raises(raised, match="lost at the commit") as caught:
        run(session, Listener(), forced="a test of the upload")
    session.close("failed")
    exported = session.state.exported
    assert exported["uploaded"] is None
    assert [e.name for e in journal_events(session)][-2:] == ["exported", "closed"]
    assert unknown in exported.get("unknown", "")
    text = session_text(session.journal.path.parent, session.state, accepted=True)
    assert f"Controller  {'not known: ' if unknown else 'nothing uploaded'}" in text
    assert hasattr(caught.value, "__notes__") == (error is KeyboardInterrupt)


@pytest.mark.parametrize(
    ("lost", "upload"),
    [(True, "lost at the commit"), (False, "the parameters were uploaded to slot A and read back")],
)
def test_upload_outcome_is_reported_if_the_journal_fails(make_session, monkeypatch, lost, upload):
    session = make_session(short_procedure(8))
    write = os.write

    def write_to_full_disk(descriptor: int, data: bytes) -> int:
        if b'"exported"' in data and b"interrupted" not in data:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(descriptor, data)

    monkeypatch.setattr(os, "write", write_to_full_disk)
    if lost:
        monkeypatch.setattr(session.arm, "upload_parameters", failing(UploadUnknown))
    with pytest.raises(JournalError) as error:
        run(session, Listener(), forced="a test of the upload")
    session.close("failed")
    happened = f"{upload}. Then: cannot write {session.journal.path}: No space left on device"
    assert error.value.happened == happened
    assert str(error.value).startswith(f"{happened}. Free space")


def test_export_of_a_calibration_not_accepted_needs_a_reason(make_session):
    procedure = short_procedure(5)
    limits = replace(procedure.acceptance, sigma_pos_mm=1e-6)
    session = make_session(replace(procedure, acceptance=limits))
    result = run(session, Listener())
    assert not result.solution.accepted
    assert result.exported is None
    # The poses are written for the search for the cause.
    poses = load_poses(session.journal.path.parent / "poses.csv", joint_count=7).poses
    assert poses.sha256() == session.state.pose_set().sha256()
    with pytest.raises(GuardError, match=r"was not accepted: .*sigma_pos") as error:
        export(session, result.solution, upload_too=True)
    assert "--force" in error.value.remedy
    assert session.arm.active_parameters() == b""
    assert not session.state.exported

    forced = run(session, Listener(), forced="the demo\nis tonight")
    assert session.state.exported["forced"] == "the demo\nis tonight"
    warning = load_parameters(forced.exported.parameters).warnings[0]
    assert warning.code == "FORCED"
    assert warning.text.endswith("exported because: the demo is tonight")
    assert "sigma_pos" in warning.text
    assert session.arm.active_parameters() == forced.exported.parameters.read_bytes()

    session.arm.reads_rad[3] = 0.0  # its counter was reset
    with pytest.raises(ConnectAgainError, match=r"joint 3 reads 0\.000 deg"):
        export(session, result.solution, upload_too=True, forced="again")
    assert session.state.exported["forced"] == "the demo\nis tonight"


def test_reason_for_an_accepted_calibration_is_not_recorded(make_session):
    session = make_session(short_procedure(20))
    result = run(session, Listener(), forced="just in case")
    assert result.solution.accepted
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
    assert exported.parameters.name == "parameters.yaml"
    assert receipt.length == len(exported.parameters.read_bytes())
    resumed.close("done")

    other_controller = make_session(procedure, resume=True, connect=True)
    export_there = recorded_export(other_controller, other_controller.arm.active_parameters())
    assert export_there.receipt is None
    exported.parameters.write_text("changed")
    assert recorded_export(other_controller, b"") is None
