"""Giving the controller a parameter document and making sure it has it. Knows bytes, not what they mean."""

from __future__ import annotations

import hashlib

from hardware.arm import UploadReceipt
from hardware.errors import ControlDenied, SdoRefused, UploadRefused
from hardware.objects import (
    COMMAND,
    DIGEST,
    DIGEST_LENGTH,
    DIGEST_SHA256,
    DOCUMENT,
    HOME_OFFSET,
    REFUSAL,
    SLOTS,
    SLOTS_ACTIVE,
    SUPERVISOR_NODE,
    TOKEN,
    Abort,
    ParameterCommand,
    Slot,
    joint_node,
)
from hardware.sdo import ObjectAccess


def read_document(access: ObjectAccess) -> bytes:
    """The document the controller holds; empty if it holds none."""
    try:
        return access.read(SUPERVISOR_NODE, DOCUMENT)
    except SdoRefused as refused:
        if refused.code == Abort.NO_DATA:
            return b""
        raise


def upload(access: ObjectAccess, document: bytes, *, joints: int) -> UploadReceipt:
    """Write a document, have it checked, read it back, and only then make it the active one.

    Raises
    ------
    UploadRefused
        With the controller's words; the document that was active before stays active.
    ControlDenied
        If the control token is not held.
    """
    try:
        access.write(SUPERVISOR_NODE, DOCUMENT, 0, document)
        _command(access, ParameterCommand.STAGE)
        _compare(access, document)
        _command(access, ParameterCommand.COMMIT)
    except SdoRefused as refused:
        raise _in_its_words(access, refused) from refused
    sha256 = access.read(SUPERVISOR_NODE, DIGEST, DIGEST_SHA256)
    active = access.read_unsigned(SUPERVISOR_NODE, SLOTS, SLOTS_ACTIVE)
    return UploadReceipt(
        slot=Slot(active).name,
        sha256=sha256.hex(),
        length=access.read_unsigned(SUPERVISOR_NODE, DIGEST, DIGEST_LENGTH),
        home_offset_counts=tuple(
            access.read_signed(joint_node(j), HOME_OFFSET) for j in range(1, joints + 1)
        ),
    )


def _command(access: ObjectAccess, command: ParameterCommand) -> None:
    access.write_unsigned(SUPERVISOR_NODE, COMMAND, 0, command, 1)


def _compare(access: ObjectAccess, document: bytes) -> None:
    """Compare what the controller staged with what was sent, byte for byte and by digest."""
    held = access.read(SUPERVISOR_NODE, DOCUMENT)
    sha256 = access.read(SUPERVISOR_NODE, DIGEST, DIGEST_SHA256)
    length = access.read_unsigned(SUPERVISOR_NODE, DIGEST, DIGEST_LENGTH)
    if held == document and length == len(document) and sha256 == hashlib.sha256(document).digest():
        return
    _command(access, ParameterCommand.ROLL_BACK)
    at = next((k for k, (a, b) in enumerate(zip(held, document, strict=False)) if a != b), None)
    where = f"{len(held)} bytes came back" if at is None else f"byte {at} differs"
    raise UploadRefused(
        f"The document read back from the controller is not the one sent ({where} of "
        f"{len(document)}). It was dropped; the one before stays active."
    )


def _in_its_words(access: ObjectAccess, refused: SdoRefused) -> UploadRefused | ControlDenied:
    if refused.code == Abort.LOCAL_CONTROL:
        return ControlDenied(access.read_unsigned(SUPERVISOR_NODE, TOKEN), refusal(access))
    return UploadRefused(refusal(access) or str(refused))


def refusal(access: ObjectAccess) -> str:
    """The supervisor's words for what it refused last; empty if it has none."""
    try:
        return access.read_text(SUPERVISOR_NODE, REFUSAL)
    except SdoRefused:
        return ""
