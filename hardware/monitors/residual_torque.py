"""A torque or an offset that a drive holds, and no frame of ours sets to 0: named, or written to 0.

In free mode a joint obeys its target torque and the offset on it, and our RPDOs may carry neither: what somebody
left there would push the arm as soon as it is let go. An offset on the position is added to every target. Read
before anything is enabled, and written only where the profile has the drives set up. Moves nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from hardware.canopen.bus_profile import BusProfile, JointProfile
from hardware.canopen.maps import ABSENT
from hardware.canopen.objects import POSITION_OFFSET, TARGET_TORQUE, TORQUE_OFFSET
from hardware.canopen.sdo import ObjectAccess
from hardware.errors import InProfile, MappingDiffers, NotZeroed, ObjectMismatch, SdoRefused

ADDED: Final = (TARGET_TORQUE, TORQUE_OFFSET, POSITION_OFFSET)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Held:
    """What a drive holds in an object, and how many bytes wide."""

    node: int
    index: int
    value: int
    size: int


def zero_added(access: ObjectAccess, profile: BusProfile) -> Iterator[str]:
    """Make sure that every drive adds nothing; where the profile has PDOs written, write 0.

    Yields
    ------
    What was written, a sentence for each object as soon as it is.

    Raises
    ------
    MappingDiffers
        Naming every object that is not 0, of a profile that only compares.
    NotZeroed
        A drive does not take the 0.
    """
    held = [found for joint in profile.joints for found in _held(access, joint)]
    if not profile.configures_pdos and held:
        raise MappingDiffers(
            [
                ObjectMismatch(
                    node=f.node,
                    index=f.index,
                    expected="0",
                    found=str(f.value),
                    in_profile=InProfile.AS_ZERO,
                )
                for f in held
            ]
        )
    for found in held:
        who = profile.who(found.node)
        try:
            access.write_unsigned(found.node, found.index, 0, 0, found.size)
        except SdoRefused as refusal:
            raise NotZeroed([f"{who}: {refusal}; it was to be 0"]) from refusal
        yield f"{who}: {found.index:04X}h is 0; it was {found.value}"


def _held(access: ObjectAccess, joint: JointProfile) -> Iterator[_Held]:
    """What is not 0 of a drive, and is not sent to it as 0 with every command."""
    sent = frozenset[int]().union(*(pdo.carried for pdo in joint.commands))
    for index in ADDED:
        if index in sent:
            continue
        try:
            data = access.read(joint.node, index)
        except SdoRefused as refusal:
            if refusal.code in ABSENT:
                continue
            raise
        value = int.from_bytes(data, "little", signed=True)
        if value:
            yield _Held(node=joint.node, index=index, value=value, size=len(data))
