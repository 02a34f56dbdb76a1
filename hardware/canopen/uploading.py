"""Giving the controller a parameter document and making sure it has it. Knows bytes, not what they mean."""

from __future__ import annotations

import hashlib
import threading
from contextlib import suppress

from hardware.arm import UploadReceipt
from hardware.canopen.bus_profile import BusProfile
from hardware.canopen.objects import (
    COMMAND,
    DIGEST,
    DIGEST_LENGTH,
    DIGEST_SHA256,
    DOCUMENT,
    HOME_OFFSET,
    REFUSAL,
    SLOTS,
    SLOTS_ACTIVE,
    SLOTS_STAGED,
    TOKEN,
    Abort,
    ParameterCommand,
    Slot,
)
from hardware.canopen.sdo import ObjectAccess
from hardware.errors import (
    BusError,
    ControlDenied,
    SdoRefused,
    TwoDevices,
    UploadRefused,
    UploadUnknown,
)

LOOKS, LOOK_AGAIN_S = 5, 0.2
"""How often a supervisor is told and asked, and how long it is given in between, once an answer was lost."""


def read_document(access: ObjectAccess, profile: BusProfile) -> bytes:
    """The document the controller holds; empty if it holds none, and for an arm without a supervisor."""
    if profile.supervisor is None:
        return b""
    try:
        return access.read(profile.supervisor, DOCUMENT)
    except SdoRefused as refused:
        if refused.code == Abort.NO_DATA:
            return b""
        raise


def upload(access: ObjectAccess, document: bytes, profile: BusProfile) -> UploadReceipt:
    """Write a document, have it checked, read it back, and only then make it the active one.

    Raises
    ------
    UploadRefused
        With the controller's words; the document that was active before stays active. Or nobody there
        keeps one.
    ControlDenied
        If the control token is not held.
    BusError
        The supervisor does not answer; the document that was active stays active.
    UploadUnknown
        It does not answer any more since it was told to make the document the active one.
    """
    supervisor = profile.supervisor
    if supervisor is None:
        raise UploadRefused(
            f"The arm of the bus profile {profile.name} has no supervisor that keeps parameters. They "
            "are in parameters.yaml of the session's folder."
        )
    try:
        _write(access, supervisor, document)
        _command(access, supervisor, ParameterCommand.STAGE)
        _compare(access, supervisor, document)
    except SdoRefused as refused:
        raise _in_its_words(access, supervisor, refused) from refused
    try:
        try:
            _commit(access, supervisor, document)
        except SdoRefused as refused:
            raise _in_its_words(access, supervisor, refused) from refused
        return _receipt(access, supervisor, profile)
    except (BusError, TwoDevices, SdoRefused) as lost:
        raise UploadUnknown(
            f"whether the controller has taken the parameters is not known: it was told to, and then: {lost}"
        ) from lost


def _write(access: ObjectAccess, supervisor: int, document: bytes) -> None:
    """Write a document; once more from its beginning if a frame of it was lost."""
    with suppress(BusError):
        access.write(supervisor, DOCUMENT, 0, document)
        return
    access.write(supervisor, DOCUMENT, 0, document)


def _commit(access: ObjectAccess, supervisor: int, document: bytes) -> None:
    """Make the staged document the active one; where no answer comes, what 2003h says counts.

    Raises
    ------
    BusError
        It is still not known.
    """
    silence: BusError | None = None
    for _ in range(LOOKS):
        try:
            _command(access, supervisor, ParameterCommand.COMMIT)
        except BusError as lost:
            silence = lost
        except SdoRefused:
            if silence is None:
                raise
            # It is at it still, or was done just now; or somebody else has the arm since.
        else:
            return
        if not access.read_unsigned(supervisor, SLOTS, SLOTS_STAGED):
            if access.read(supervisor, DIGEST, DIGEST_SHA256) == hashlib.sha256(document).digest():
                return
            raise UploadRefused(
                "The controller dropped the document before it was made the active one; the one before stays active."
            )
        threading.Event().wait(LOOK_AGAIN_S)
    raise silence or BusError("The supervisor does not say that it is done.")


def _receipt(access: ObjectAccess, supervisor: int, profile: BusProfile) -> UploadReceipt:
    """Read back what is active."""
    sha256 = access.read(supervisor, DIGEST, DIGEST_SHA256)
    active = access.read_unsigned(supervisor, SLOTS, SLOTS_ACTIVE)
    return UploadReceipt(
        slot=Slot(active).name,
        sha256=sha256.hex(),
        length=access.read_unsigned(supervisor, DIGEST, DIGEST_LENGTH),
        home_offset_counts=tuple(access.read_signed(node, HOME_OFFSET) for node in profile.drives),
    )


def _command(access: ObjectAccess, supervisor: int, command: ParameterCommand) -> None:
    access.write_unsigned(supervisor, COMMAND, 0, command, 1)


def _compare(access: ObjectAccess, supervisor: int, document: bytes) -> None:
    """Compare what the controller staged with what was sent, byte for byte and by digest."""
    held = access.read(supervisor, DOCUMENT)
    sha256 = access.read(supervisor, DIGEST, DIGEST_SHA256)
    length = access.read_unsigned(supervisor, DIGEST, DIGEST_LENGTH)
    if held == document and length == len(document) and sha256 == hashlib.sha256(document).digest():
        return
    _command(access, supervisor, ParameterCommand.ROLL_BACK)
    at = next((k for k, (a, b) in enumerate(zip(held, document, strict=False)) if a != b), None)
    where = f"{len(held)} bytes came back" if at is None else f"byte {at} differs"
    raise UploadRefused(
        f"The document read back from the controller is not the one sent ({where} of "
        f"{len(document)}). It was dropped; the one before stays active."
    )


def _in_its_words(
    access: ObjectAccess, supervisor: int, refused: SdoRefused
) -> UploadRefused | ControlDenied:
    if refused.code == Abort.LOCAL_CONTROL:
        return ControlDenied(access.read_unsigned(supervisor, TOKEN), refusal(access, supervisor))
    return UploadRefused(refusal(access, supervisor) or str(refused))


def refusal(access: ObjectAccess, supervisor: int) -> str:
    """The supervisor's words for what it refused last; empty if it has none."""
    try:
        return access.read_text(supervisor, REFUSAL)
    except SdoRefused:
        return ""
