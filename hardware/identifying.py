"""Who is on the bus, and whether it is the arm the description means. Knows SDO access; moves nothing."""

from __future__ import annotations

from collections.abc import Iterable

from hardware.arm import ArmIdentity, NodeIdentity
from hardware.description import ArmDescription, EncoderDescription, JointDescription
from hardware.errors import WrongArm
from hardware.limits import joint_limits
from hardware.objects import (
    ARM,
    ARM_JOINTS,
    ARM_MODEL,
    ARM_SERIAL,
    CONTROL_PERIOD,
    DEVICE_NAME,
    DEVICE_TYPE,
    DEVICE_TYPE_MASK,
    DRIVE_DEVICE_TYPE,
    ENCODER_RESOLUTION,
    IDENTITY,
    IDENTITY_PRODUCT,
    IDENTITY_REVISION,
    IDENTITY_SERIAL,
    IDENTITY_VENDOR,
    POSITION_LIMITS,
    RATED_TORQUE,
    SENSOR,
    SENSOR_BITS,
    SENSOR_FULL_SCALE,
    SENSOR_KIND,
    SUPERVISOR_NODE,
    SensorKind,
    joint_node,
)
from hardware.sdo import ObjectAccess


def read_identity(access: ObjectAccess, joints: int) -> ArmIdentity:
    """Ask every node who it is (1008h, 1018h), and the supervisor which arm this is (2020h)."""
    nodes = [(joint_node(j), f"joint {j}") for j in range(1, joints + 1)]
    nodes.append((SUPERVISOR_NODE, "supervisor"))
    return ArmIdentity(
        model=access.read_text(SUPERVISOR_NODE, ARM, ARM_MODEL),
        serial_number=access.read_text(SUPERVISOR_NODE, ARM, ARM_SERIAL),
        nodes=tuple(
            NodeIdentity(
                node=node,
                role=role,
                device_name=access.read_text(node, DEVICE_NAME),
                vendor_id=access.read_unsigned(node, IDENTITY, IDENTITY_VENDOR),
                product_code=access.read_unsigned(node, IDENTITY, IDENTITY_PRODUCT),
                revision=access.read_unsigned(node, IDENTITY, IDENTITY_REVISION),
                serial_number=access.read_unsigned(node, IDENTITY, IDENTITY_SERIAL),
            )
            for node, role in nodes
        ),
    )


def check_arm(
    access: ObjectAccess, identity: ArmIdentity, description: ArmDescription, *, period_s: float
) -> None:
    """Compare the arm on the bus with its description.

    Raises
    ------
    WrongArm
        Naming everything that differs.
    """
    found = list(_arm_differences(access, identity, description))
    for joint, expected in enumerate(description.joints, 1):
        found += [
            f"joint {joint} {what}"
            for what in _joint_differences(access, joint, expected, period_s)
        ]
    if found:
        raise WrongArm(
            "The arm on the bus is not the one in the arm file: "
            + "; ".join(found)
            + ". Choose the file that belongs to this arm."
        )


def read_rated_torques_nm(access: ObjectAccess, joints: int) -> tuple[float, ...]:
    """What 1000 per mille of 6077h mean for every joint (6076h)."""
    return tuple(
        access.read_unsigned(joint_node(j), RATED_TORQUE) * 1e-3 for j in range(1, joints + 1)
    )


def _arm_differences(
    access: ObjectAccess, identity: ArmIdentity, description: ArmDescription
) -> Iterable[str]:
    if identity.model != description.model:
        yield f"its model is {identity.model!r}, expected {description.model!r}"
    joints = access.read_unsigned(SUPERVISOR_NODE, ARM, ARM_JOINTS)
    if joints != len(description.joints):
        yield f"it has {joints} joints, expected {len(description.joints)}"


def _joint_differences(
    access: ObjectAccess, joint: int, expected: JointDescription, period_s: float
) -> Iterable[str]:
    node = joint_node(joint)
    device = access.read_unsigned(node, DEVICE_TYPE)
    if device & DEVICE_TYPE_MASK != DRIVE_DEVICE_TYPE:
        yield f"is no CiA 402 servo drive (1000h = {device:08X}h)"
        return
    yield from _sensor_differences(access, node, expected)
    limits = joint_limits(
        joint,
        expected.scale,
        lower_rad=expected.lower_rad,
        upper_rad=expected.upper_rad,
        max_speed_rad_per_s=expected.max_speed_rad_per_s,
        period_s=period_s,
    )
    ends = tuple(access.read_signed(node, POSITION_LIMITS, sub) for sub in (1, 2))
    if ends != (limits.lower_counts, limits.upper_counts):
        yield (
            f"has the range {ends[0]} .. {ends[1]} counts, expected "
            f"{limits.lower_counts} .. {limits.upper_counts}"
        )
    value, index = (
        access.read_unsigned(node, CONTROL_PERIOD, 1),
        access.read_signed(node, CONTROL_PERIOD, 2),
    )
    if abs(value * 10.0**index - period_s) > 1e-9:
        yield f"has a control period of {value * 10.0**index:g} s, expected {period_s:g} s"


def _sensor_differences(
    access: ObjectAccess, node: int, expected: JointDescription
) -> Iterable[str]:
    kind = access.read_unsigned(node, SENSOR, SENSOR_KIND)
    sensor = expected.sensor
    if isinstance(sensor, EncoderDescription):
        if kind != SensorKind.ENCODER:
            yield f"has sensor kind {kind}, expected an encoder ({SensorKind.ENCODER:d})"
            return
        counts, turns = (access.read_unsigned(node, ENCODER_RESOLUTION, sub) for sub in (1, 2))
        if counts != sensor.counts_per_rev * turns:
            yield (
                f"has an encoder of {counts} counts in {turns} turn(s), expected "
                f"{sensor.counts_per_rev} a turn"
            )
        return
    if kind != SensorKind.RVDT:
        yield f"has sensor kind {kind}, expected an RVDT ({SensorKind.RVDT:d})"
        return
    bits = access.read_unsigned(node, SENSOR, SENSOR_BITS)
    full_scale = access.read_unsigned(node, SENSOR, SENSOR_FULL_SCALE)
    if bits != sensor.bits:
        yield f"has a converter of {bits} bits, expected {sensor.bits}"
    if abs(full_scale - sensor.full_scale_microdegrees) > 1:
        yield (
            f"has an RVDT of {full_scale * 1e-6:.6f} deg full scale, expected "
            f"{sensor.full_scale_microdegrees * 1e-6:.6f} deg"
        )
