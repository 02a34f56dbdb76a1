"""Uploads a parameter document (bytes) to the supervisor, verifies it and commits it."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable
from contextlib import suppress

from hardware.arm import UploadReceipt
from hardware.canopen import objects
from hardware.canopen.bus_profile import BusProfile
from hardware.canopen.objects import Abort, ParameterCommand, Slot
from hardware.canopen.sdo import ObjectAccess
from hardware.errors import (
    BusError,
    ControlDenied,
    DuplicateNodeId,
    FramesLost,
    HardwareError,
    SdoRefused,
    UploadRefused,
    UploadUnknown,
)

MAX_UPLOADS = 6


def read_document(access: ObjectAccess, profile: BusProfile) -> bytes:
    """Active document of the controller; empty if there is none, or no supervisor."""
    if profile.supervisor is None:
        return b""
    try:
        return access.read(profile.supervisor, objects.DOCUMENT)
    except SdoRefused as refused:
        if refused.code == Abort.NO_DATA:
            return b""
        raise


def upload(
    access: ObjectAccess,
    profile: BusProfile,
    document: bytes,
    *,
    retry_s: float,
    may_repeat: Callable[[HardwareError], bool],
    explain: Callable[[HardwareError], HardwareError],
) -> UploadReceipt:
    """Write a document, stage it, read it back and commit it; `retry_s` is the pause between attempts.

    Steps are repeated if an answer is missing or control has lapsed, since nothing is active before the commit, and
    2003h and 2001h show whether a commit was carried out. After an error, the previous document stays active.

    Parameters
    ----------
    may_repeat
        Whether to try again after this error: whether the arm is heard and control is held or was taken again.
    explain
        Returns the error, or in its place the host latency that caused it.

    Raises
    ------
    UploadRefused
        The supervisor refused the document (its reason is given), or there is no supervisor.
    ControlDenied
        The control token is not held.
    BusError
        The supervisor does not answer.
    UploadUnknown
        It stopped answering after the commit was sent: the outcome is unknown.
    """
    if profile.supervisor is None:
        raise UploadRefused(
            f"The arm of the bus profile {profile.name} has no supervisor that stores parameters. They "
            "are in parameters.yaml of the session's folder."
        )
    attempt = _Attempt(access, profile.supervisor, document)
    for left in reversed(range(MAX_UPLOADS)):
        try:
            if not attempt.committed():
                attempt.stage()
                attempt.commit()
            return _receipt(access, attempt.supervisor, profile)
        except (BusError, DuplicateNodeId, SdoRefused) as lost:
            if left and attempt.is_transient(lost) and may_repeat(lost):
                threading.Event().wait(retry_s)
                continue
            why, known = explain(lost), False
            with suppress(BusError, DuplicateNodeId, SdoRefused):
                if attempt.committed():
                    return _receipt(access, attempt.supervisor, profile)
                known = not attempt.commit_pending()
            if attempt.commit_sent and not known:
                raise UploadUnknown(
                    "it is not known whether the controller has stored the parameters: the commit was sent, and then: "
                    f"{why}"
                ) from lost
            if why is lost and isinstance(lost, SdoRefused):
                reason = refusal(access, attempt.supervisor)
                why = UploadRefused(reason or str(lost))
                if lost.code == Abort.LOCAL_CONTROL:
                    why = ControlDenied(
                        access.read_unsigned(attempt.supervisor, objects.TOKEN), reason
                    )
            raise why from lost
    raise AssertionError("unreachable: the last attempt returns or raises")


class _Attempt:
    """Upload of one document; `commit_sent`: whether a commit was sent whose outcome is not known."""

    def __init__(self, access: ObjectAccess, supervisor: int, document: bytes) -> None:
        self._access, self.supervisor, self._document = access, supervisor, document
        self._answer_missed = False
        self.commit_sent = False

    def is_transient(self, error: HardwareError) -> bool:
        """Whether a further attempt may succeed.

        A refusal after a missed answer is transient: the earlier command may have been carried out.
        """
        if isinstance(error, SdoRefused):
            return error.code == Abort.LOCAL_CONTROL or self._answer_missed
        self._answer_missed = self._answer_missed or isinstance(error, BusError)
        return not isinstance(error, DuplicateNodeId | FramesLost)

    def stage(self) -> None:
        """Write, stage and compare the document, unless it is still staged for a commit."""
        if self.commit_pending():
            return
        self.commit_sent = False
        self._access.write(self.supervisor, objects.DOCUMENT, 0, self._document)
        self._access.command(self.supervisor, objects.COMMAND, 0, ParameterCommand.STAGE)
        _compare(self._access, self.supervisor, self._document)

    def commit(self) -> None:
        """Activate the staged document and check that it is active."""
        try:
            self.commit_sent = True
            self._access.command(self.supervisor, objects.COMMAND, 0, ParameterCommand.COMMIT)
        except SdoRefused:
            self.commit_sent = self._answer_missed
            raise
        if not self.committed():
            raise BusError(
                f"Node {self.supervisor} confirmed the commit, but 2003h does not show the document as active. "
                "Upload it again."
            )

    def committed(self) -> bool:
        """Whether a commit was sent, and the document is active."""
        return (
            self.commit_sent
            and not self.commit_pending()
            and self._access.read(self.supervisor, objects.DIGEST, objects.DIGEST_SHA256)
            == hashlib.sha256(self._document).digest()
        )

    def commit_pending(self) -> bool:
        """Whether a commit was sent, and the document is still staged."""
        return self.commit_sent and bool(
            self._access.read_unsigned(self.supervisor, objects.SLOTS, objects.SLOTS_STAGED)
        )


def _receipt(access: ObjectAccess, supervisor: int, profile: BusProfile) -> UploadReceipt:
    """Read back the active document's digest and home offsets."""
    sha256 = access.read(supervisor, objects.DIGEST, objects.DIGEST_SHA256)
    active = access.read_unsigned(supervisor, objects.SLOTS, objects.SLOTS_ACTIVE)
    return UploadReceipt(
        slot=Slot(active).name,
        sha256=sha256.hex(),
        length=access.read_unsigned(supervisor, objects.DIGEST, objects.DIGEST_LENGTH),
        home_offset_counts=tuple(
            access.read_signed(node, objects.HOME_OFFSET) for node in profile.drives
        ),
    )


def _compare(access: ObjectAccess, supervisor: int, document: bytes) -> None:
    """Compare the staged document with the one sent, byte for byte and by digest; if it differs, drop it."""
    staged = access.read(supervisor, objects.DOCUMENT)
    sha256 = access.read(supervisor, objects.DIGEST, objects.DIGEST_SHA256)
    length = access.read_unsigned(supervisor, objects.DIGEST, objects.DIGEST_LENGTH)
    digest = hashlib.sha256(document).digest()
    if staged == document and length == len(document) and sha256 == digest:
        return
    access.command(supervisor, objects.COMMAND, 0, ParameterCommand.ROLL_BACK)
    at = next((k for k, (a, b) in enumerate(zip(staged, document, strict=False)) if a != b), None)
    where = f"{len(staged)} bytes came back" if at is None else f"byte {at} differs"
    raise UploadRefused(
        f"The document read back from the controller differs from the one sent ({where} of "
        f"{len(document)}). It was dropped; the previous one stays active."
    )


def refusal(access: ObjectAccess, supervisor: int) -> str:
    """The supervisor's reason for its last refusal (2004h); empty if there is none."""
    try:
        return access.read_text(supervisor, objects.REFUSAL)
    except SdoRefused:
        return ""
