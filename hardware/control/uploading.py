"""Uploads a parameter document (bytes) to the supervisor, verifies it and commits it."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from hardware import errors
from hardware.arm import UploadReceipt
from hardware.canopen import objects
from hardware.canopen.objects import Abort, ParameterCommand, Slot
from hardware.canopen.sdo import MAX_DOCUMENT_BYTES, ObjectAccess

if TYPE_CHECKING:
    from hardware.control.connection import Connection

MAX_UPLOADS = 6


def upload(link: Connection, document: bytes) -> UploadReceipt:
    """Write a document, stage it, read it back and commit it.

    Steps are repeated if an answer is missing or the control token has expired. That is safe: nothing becomes active
    before the commit, and 2003h and 2001h show whether a commit was carried out. After any error but
    `UploadUnknown`, the previous document stays active.

    Raises `UploadRefused` if the supervisor refused the document (its reason is given) or there is no supervisor,
    `ControlDenied` if the control token is not held, `BusError` if the supervisor does not answer, and `UploadUnknown`
    if the supervisor stopped answering after the commit was sent: the outcome is unknown.
    """
    access, supervisor = link.access, link.profile.supervisor
    if supervisor is None:
        raise errors.UploadRefused(
            f"The arm of the bus profile {link.profile.name} has no supervisor that stores parameters. They "
            "are in parameters.yaml of the session's folder."
        )
    attempt = _Attempt(access, supervisor, document)
    for attempts_left in reversed(range(MAX_UPLOADS)):
        try:
            if not attempt.committed():
                attempt.stage()
                attempt.commit()
            return attempt.receipt(link.profile.drives)
        except (errors.BusError, errors.DuplicateNodeId, errors.SdoRefused) as lost:
            if attempts_left and attempt.is_transient(lost) and link.may_repeat(lost):
                threading.Event().wait(link.on_bus.timing.upload_retry_s)
                continue
            why, known = link.explain(lost), False
            with suppress(errors.BusError, errors.DuplicateNodeId, errors.SdoRefused):
                if attempt.committed():
                    return attempt.receipt(link.profile.drives)
                known = not attempt.commit_pending()
            if attempt.commit_sent and not known:
                raise errors.UploadUnknown(
                    "it is not known whether the controller has stored the parameters: the commit was sent, and then: "
                    f"{why}"
                ) from lost
            if why is lost and isinstance(lost, errors.SdoRefused):
                reason = refusal(access, supervisor)
                refused = (reason or str(lost)).removesuffix(".")
                why = errors.UploadRefused(
                    f"the controller refused the parameters: {refused}. The previously active ones stay active."
                )
                if lost.code == Abort.LOCAL_CONTROL:
                    holder = access.read_unsigned(supervisor, objects.TOKEN)
                    why = errors.ControlDenied(holder, reason)
            raise why from lost
    raise AssertionError("unreachable: the last attempt returns or raises")


class _Attempt:
    """Upload of one document; `commit_sent`: whether a commit was sent and may have been carried out."""

    def __init__(self, access: ObjectAccess, supervisor: int, document: bytes) -> None:
        self._access, self._supervisor, self._document = access, supervisor, document
        self._sha256 = hashlib.sha256(document).digest()
        self._answer_missed = False
        self.commit_sent = False

    def is_transient(self, error: errors.HardwareError) -> bool:
        """Whether a further attempt may succeed after this error.

        A refusal after a missed answer is transient too: the unanswered command may have been carried out.
        """
        if isinstance(error, errors.SdoRefused):
            return error.code == Abort.LOCAL_CONTROL or self._answer_missed
        self._answer_missed = self._answer_missed or isinstance(error, errors.BusError)
        return not isinstance(error, errors.DuplicateNodeId | errors.FramesLost)

    def stage(self) -> None:
        if self.commit_pending():
            return
        self.commit_sent = False
        self._access.write(self._supervisor, objects.DOCUMENT, 0, self._document)
        self._access.command(self._supervisor, objects.COMMAND, 0, ParameterCommand.STAGE)
        self._compare()

    def commit(self) -> None:
        try:
            self.commit_sent = True
            self._access.command(self._supervisor, objects.COMMAND, 0, ParameterCommand.COMMIT)
        except errors.SdoRefused:
            self.commit_sent = self._answer_missed
            raise
        if not self.committed():
            raise errors.BusError(
                f"Node {self._supervisor} confirmed the commit, but 2003h does not show the document as active. "
                "Upload it again."
            )

    def committed(self) -> bool:
        return (
            self.commit_sent and not self.commit_pending() and self._read_sha256() == self._sha256
        )

    def commit_pending(self) -> bool:
        return self.commit_sent and bool(
            self._access.read_unsigned(self._supervisor, objects.SLOTS, objects.SLOTS_STAGED)
        )

    def receipt(self, drives: Sequence[int]) -> UploadReceipt:
        sha256 = self._read_sha256()
        active = self._access.read_unsigned(self._supervisor, objects.SLOTS, objects.SLOTS_ACTIVE)
        return UploadReceipt(
            slot=Slot(active).name,
            sha256=sha256.hex(),
            length=self._read_length(),
            home_offset_counts=tuple(
                self._access.read_signed(node, objects.HOME_OFFSET) for node in drives
            ),
        )

    def _compare(self) -> None:
        document = self._document
        staged = self._access.read(self._supervisor, objects.DOCUMENT, max_bytes=MAX_DOCUMENT_BYTES)
        sha256, length = self._read_sha256(), self._read_length()
        if staged == document and length == len(document) and sha256 == self._sha256:
            return
        self._access.command(self._supervisor, objects.COMMAND, 0, ParameterCommand.ROLL_BACK)
        pairs = enumerate(zip(staged, document, strict=False))
        at = next((k for k, (a, b) in pairs if a != b), None)
        size = len(document)
        where = f"{len(staged)} of {size} bytes came back" if at is None else f"byte {at} of {size}"
        if staged == document:
            where = f"the bytes agree, but 2001h states {length} bytes and SHA-256 {sha256.hex()}"
        raise errors.UploadRefused(
            f"The document read back from the controller differs from the one sent ({where}). It was "
            "dropped; the previous one stays active."
        )

    def _read_sha256(self) -> bytes:
        return self._access.read(self._supervisor, objects.DIGEST, objects.DIGEST_SHA256)

    def _read_length(self) -> int:
        return self._access.read_unsigned(self._supervisor, objects.DIGEST, objects.DIGEST_LENGTH)


def refusal(access: ObjectAccess, supervisor: int) -> str:
    """Read the supervisor's reason for its last refusal (2004h); empty if there is none."""
    try:
        return access.read_text(supervisor, objects.REFUSAL)
    except errors.SdoRefused:
        return ""
