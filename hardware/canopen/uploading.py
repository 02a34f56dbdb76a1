"""Giving the controller a parameter document and making sure it has it. Knows bytes, not what they mean."""

from __future__ import annotations

import hashlib
import threading
from contextlib import suppress
from typing import Protocol

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
    FramesLost,
    HardwareError,
    SdoRefused,
    TwoDevices,
    UploadRefused,
    UploadUnknown,
)

UPLOADS, AGAIN_AFTER_S = 6, 0.5
"""How often a document is uploaded from its beginning, and the pause between: a token that lapsed is given again as
soon as the supervisor has heard a heartbeat (100 ms)."""


class UploadLink(Protocol):
    """The connection that a document is uploaded through."""

    access: ObjectAccess
    profile: BusProfile

    def may_repeat(self, error: HardwareError) -> bool:
        """Whether what failed so may be done again: the arm is heard, and control is held, or held again."""
        ...

    def explain(self, error: HardwareError) -> HardwareError:
        """Return the error, or in its place the lateness of this computer that it comes from."""
        ...


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


def upload(link: UploadLink, document: bytes) -> UploadReceipt:
    """Write a document, have it checked, read it back, and only then make it the active one.

    All of it is repeated where an answer is missing or control has lapsed: nothing is active before the commit, and
    whether a commit was carried out, 2003h and 2001h say.

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
    if link.profile.supervisor is None:
        raise UploadRefused(
            f"The arm of the bus profile {link.profile.name} has no supervisor that keeps parameters. They "
            "are in parameters.yaml of the session's folder."
        )
    attempt = _Attempt(link.access, link.profile.supervisor, document)
    for left in reversed(range(UPLOADS)):
        try:
            if not attempt.committed():
                attempt.stage()
                attempt.commit()
            return _receipt(link.access, attempt.supervisor, link.profile)
        except (BusError, TwoDevices, SdoRefused) as lost:
            if left and attempt.passing(lost) and link.may_repeat(lost):
                threading.Event().wait(AGAIN_AFTER_S)
                continue
            why, known = link.explain(lost), False
            with suppress(BusError, TwoDevices, SdoRefused):
                if attempt.committed():
                    return _receipt(link.access, attempt.supervisor, link.profile)
                known = not attempt.under_way()
            if attempt.ordered and not known:
                raise UploadUnknown(
                    f"whether the controller has taken the parameters is not known: it was told to, and then: {why}"
                ) from lost
            if why is lost and isinstance(lost, SdoRefused):
                why = _in_its_words(link.access, attempt.supervisor, lost)
            raise why from lost
    raise AssertionError("the last attempt ends in one of these ways")


class _Attempt:
    """A document on its way.

    Attributes
    ----------
    ordered
        Whether the supervisor was told to make it the active one, and what came of it is not known.
    """

    def __init__(self, access: ObjectAccess, supervisor: int, document: bytes) -> None:
        self._access, self.supervisor, self._document = access, supervisor, document
        self._missed = False
        self.ordered = False

    def passing(self, error: HardwareError) -> bool:
        """Whether the cause of an error may be gone the next time.

        A refusal is one that comes after a missing answer: the command before is being carried out still, or was.
        """
        if isinstance(error, SdoRefused):
            return error.code == Abort.LOCAL_CONTROL or self._missed
        self._missed = self._missed or isinstance(error, BusError)
        return not isinstance(error, TwoDevices | FramesLost)

    def stage(self) -> None:
        """Write the document, have it checked and compare what was staged; again only what a commit does not need."""
        if self.under_way():
            return
        self.ordered = False
        self._access.write(self.supervisor, DOCUMENT, 0, self._document)
        self._access.command(self.supervisor, COMMAND, 0, ParameterCommand.STAGE)
        _compare(self._access, self.supervisor, self._document)

    def commit(self) -> None:
        """Make the staged document the active one, and see that it is."""
        try:
            self.ordered = True
            self._access.command(self.supervisor, COMMAND, 0, ParameterCommand.COMMIT)
        except SdoRefused:
            self.ordered = self._missed
            raise
        if not self.committed():
            raise BusError(
                f"Node {self.supervisor} says that it has made the document the active one, and 2003h does not."
            )

    def committed(self) -> bool:
        """Whether the supervisor was told to make the document active, and has."""
        return (
            self.ordered
            and not self.under_way()
            and self._access.read(self.supervisor, DIGEST, DIGEST_SHA256)
            == hashlib.sha256(self._document).digest()
        )

    def under_way(self) -> bool:
        """Whether the supervisor was told to make the document active, and has it staged still."""
        return self.ordered and bool(
            self._access.read_unsigned(self.supervisor, SLOTS, SLOTS_STAGED)
        )


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


def _compare(access: ObjectAccess, supervisor: int, document: bytes) -> None:
    """Compare what the controller staged with what was sent, byte for byte and by digest."""
    held = access.read(supervisor, DOCUMENT)
    sha256 = access.read(supervisor, DIGEST, DIGEST_SHA256)
    length = access.read_unsigned(supervisor, DIGEST, DIGEST_LENGTH)
    if held == document and length == len(document) and sha256 == hashlib.sha256(document).digest():
        return
    access.command(supervisor, COMMAND, 0, ParameterCommand.ROLL_BACK)
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
