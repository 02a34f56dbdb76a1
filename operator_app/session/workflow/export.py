"""Export of a calibration: the session's files, and the upload to the controller."""

import hashlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from hardware.arm import ArmInterface, UploadReceipt
from hardware.errors import HardwareError, UploadUnknown
from operator_app.calibration.result import Solution
from operator_app.calibration.serialization import to_dict
from operator_app.config.atomic import write_atomically
from operator_app.config.parameters_file import format_parameters
from operator_app.config.poses_file import save_poses
from operator_app.errors import JournalError, SessionError
from operator_app.messages.errors import words
from operator_app.session.store.folders import PARAMETERS_NAME, POSES_NAME
from operator_app.session.store.parameters_document import export_reason
from operator_app.session.workflow.session import Session


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """Result of an export: the parameters file, its SHA-256, and the receipt of the upload (None without an upload)."""

    parameters: Path
    sha256: str
    receipt: UploadReceipt | None


def export(
    session: Session, solution: Solution, *, upload_too: bool | None = None, forced: str = ""
) -> Exported:
    """Write the session's files; upload the parameters if `upload_too` is true (None: as the procedure states).

    `forced`: reason for exporting a calibration that was not accepted; written to the journal and the file. Raises:

    - GuardError: nothing was exported. `forced` is required but empty or, in the case of an upload, counters or sensors
      may have changed since the poses were captured. ConnectAgainError if a counter was reset.
    - JournalError: the journal was lost or changed (JournalLostError), or cannot be written. The message states what
      was uploaded, if anything.
    - UploadUnknown, SessionError: the controller may have stored all or part of the parameters; the journal states why.
    - KeyboardInterrupt during the upload: a note to the exception states that the result is unknown.
    """
    forced = export_reason(solution, forced, stated_by="--force REASON")
    uploads = session.procedure.upload if upload_too is None else upload_too
    if uploads:
        session.require_counters_of_poses()
    if to_dict(solution) != session.state.solution:
        # The recorded solution was made with other options: record the exported solution.
        session.record_solution(solution)
    session.require_journal(unchanged=True)
    poses = session.state.pose_set()
    document = session.document(solution, forced=forced)
    path = session.journal.path.parent / PARAMETERS_NAME
    save_poses(path.with_name(POSES_NAME), poses)
    data = format_parameters(document)
    write_atomically(path, data)
    record: dict[str, Any] = {
        "file": PARAMETERS_NAME,
        "sha256": _sha256(data),
        "uploaded": None,
        "forced": forced,
    }
    receipt = None
    if uploads:
        counts = tuple(joint.home_offset_counts for joint in document.joints)
        before = session.state.exported
        interrupted = UploadUnknown(
            "the upload was interrupted: it is not known whether the controller has stored the parameters"
        )
        # Recorded before the commit: whatever ends this program, the journal does not deny the upload.
        _record_export(session, {**record, "unknown": str(interrupted)}, report="")
        try:
            receipt = _upload(session.arm, data, counts)
        except (UploadUnknown, SessionError) as error:
            _record_export(session, {**record, "unknown": str(error)}, report=str(error))
            raise
        except HardwareError as error:  # the previous parameters stay active
            _record_export(session, before or record, report=str(error))
            raise
        except KeyboardInterrupt as interrupt:
            interrupt.add_note(str(words(interrupted)))
            raise
        record["uploaded"] = asdict(receipt)
    done = f"the parameters were uploaded to slot {receipt.slot} and read back" if receipt else ""
    _record_export(session, record, report=done)
    return Exported(parameters=path, sha256=record["sha256"], receipt=receipt)


def recorded_export(session: Session, active_document: bytes) -> Exported | None:
    """Return the session's recorded export; None if there is none, or if parameters.yaml was changed afterwards.

    It has a `receipt` if the uploaded parameters.yaml is still the `active_document` of the controller.
    """
    exported, path = session.state.exported, session.journal.path.with_name(PARAMETERS_NAME)
    if not exported or not path.exists() or _sha256(path.read_bytes()) != exported.get("sha256"):
        return None
    receipt, uploaded = None, exported["uploaded"]
    if uploaded and _sha256(active_document) == exported["sha256"]:
        receipt = UploadReceipt(
            slot=uploaded["slot"],
            sha256=uploaded["sha256"],
            length=uploaded["length"],
            home_offset_counts=tuple(uploaded.get("home_offset_counts", ())),
        )
    return Exported(parameters=path, sha256=exported["sha256"], receipt=receipt)


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _record_export(session: Session, exported: Mapping[str, Any], *, report: str) -> None:
    """Record the export; if that fails, put `report`, the result of the upload, before the text of the error."""
    try:
        session.record("exported", exported)
    except JournalError as error:
        if report:
            error.preceded_by(report)
        raise


def _upload(
    arm: ArmInterface, document: bytes, expected_counts: tuple[int | None, ...]
) -> UploadReceipt:
    """Upload `document`, then check that the controller has stored the document and its home offsets.

    `expected_counts`: home offset of each joint, counts; None: not checked. Raises SessionError if what was read back
    differs, and UploadUnknown if the document could not be read back.
    """
    receipt = arm.upload_parameters(document)
    try:
        active = arm.active_parameters()
    except HardwareError as error:
        raise UploadUnknown(
            f"the parameters were uploaded to slot {receipt.slot} and could not be read back: {error}"
        ) from error
    if active != document:
        raise SessionError(
            "the active parameters of the controller differ from the uploaded ones",
            "upload again; if it happens twice, do not move the arm and check the supervisor",
        )
    for joint, (sent, read_back) in enumerate(
        zip(expected_counts, receipt.home_offset_counts, strict=True), 1
    ):
        if sent is not None and sent != read_back:
            raise SessionError(
                f"joint {joint} holds home offset {read_back} counts, {sent} were uploaded",
                "upload again; if it happens twice, do not move the arm and check that drive",
            )
    return receipt
