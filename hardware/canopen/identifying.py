"""Identifies the nodes by SDO and compares the arm on the bus with the arm file."""

import math
from collections.abc import Iterator

from hardware.arm import ArmIdentity, NodeIdentity
from hardware.arm_description import (
    ArmDescription,
    EncoderDescription,
    JointDescription,
    JointScale,
    RvdtDescription,
)
from hardware.canopen import objects
from hardware.canopen.bus_profile import BusProfile, JointProfile
from hardware.canopen.maps import ABSENT, read_if_present, read_number
from hardware.canopen.objects import SensorKind
from hardware.canopen.sdo import ObjectAccess
from hardware.command_limits import JointLimits, arm_limits
from hardware.errors import SdoRefused, WrongArm


def read_identity(
    access: ObjectAccess, profile: BusProfile, description: ArmDescription
) -> ArmIdentity:
    """Read identities of all nodes (1008h, 1018h) and of the arm (2020h of the supervisor).

    Without a supervisor, the model is taken from the arm file and the serial number from the bus profile.
    """

    def optional(node: int, sub: int) -> int:
        return read_number(access, node, objects.IDENTITY, sub) or 0

    supervisor = profile.supervisor
    nodes = [(node, f"joint {joint}") for joint, node in enumerate(profile.drives, 1)]
    model, serial_number = description.model, profile.serial_number
    if supervisor is not None:
        nodes.append((supervisor, "supervisor"))
        model = access.read_text(supervisor, objects.ARM, objects.ARM_MODEL)
        serial_number = access.read_text(supervisor, objects.ARM, objects.ARM_SERIAL)
    return ArmIdentity(
        model=model,
        serial_number=serial_number,
        keeps_parameters=supervisor is not None,
        nodes=tuple(
            NodeIdentity(
                node=node,
                role=role,
                device_name=read_if_present(access.read_text, node, objects.DEVICE_NAME) or "",
                # CiA 301 requires the vendor only.
                vendor_id=access.read_unsigned(node, objects.IDENTITY, objects.IDENTITY_VENDOR),
                product_code=optional(node, objects.IDENTITY_PRODUCT),
                revision=optional(node, objects.IDENTITY_REVISION),
                serial_number=optional(node, objects.IDENTITY_SERIAL),
            )
            for node, role in nodes
        ),
    )


def check_arm(
    access: ObjectAccess, identity: ArmIdentity, description: ArmDescription, profile: BusProfile
) -> None:
    """Compare the arm on the bus with its description: model, joints, device types, objects listed in the profile.

    Raises `WrongArm` with all differences.
    """
    differences = list[str]()
    if identity.model != description.model:
        differences.append(f"its model is {identity.model!r}, expected {description.model!r}")
    if profile.supervisor is not None:
        count = access.read_unsigned(profile.supervisor, objects.ARM, objects.ARM_JOINTS)
        if count != len(description.joints):
            differences.append(f"it has {count} joints, expected {len(description.joints)}")
    limits = arm_limits(description.joints, scales_of(description, profile))
    joints = zip(description.joints, profile.joints, limits, strict=True)
    for number, (expected, drive, limit) in enumerate(joints, 1):
        try:
            own = list(_joint_differences(access, expected, drive, limit, profile))
            differences += [f"joint {number} {text}" for text in own]
        except SdoRefused as refusal:
            if refusal.code not in ABSENT:
                raise
            differences.append(
                f"joint {number} has no object {refusal.index:04X}h, which the bus "
                f"profile {profile.name} compares"
            )
    if differences:
        raise WrongArm(
            "The arm on the bus is not the one in the arm file: "
            + "; ".join(differences)
            + ". Choose the file that belongs to this arm."
        )


def scales_of(description: ArmDescription, profile: BusProfile) -> tuple[JointScale, ...]:
    """Return every joint's scale, from the profile's counts per turn or else from the sensor."""
    scales = []
    for joint, drive in zip(description.joints, profile.joints, strict=True):
        per_rad = drive.direction * joint.sensor.counts_per_rad
        if drive.counts_per_rev is not None:
            per_rad = drive.direction * drive.counts_per_rev / math.tau
        scales.append(JointScale(counts_per_rad=per_rad, zero_counts=drive.zero_counts))
    return tuple(scales)


def read_rated_torques_nm(access: ObjectAccess, profile: BusProfile) -> tuple[float, ...]:
    """Return each joint's rated torque, N m, from the profile or else 6076h; `WrongArm` if 6076h is absent or 0."""
    torques = []
    for number, joint in enumerate(profile.joints, 1):
        if joint.rated_torque_nm is not None:
            torques.append(joint.rated_torque_nm)
            continue
        rated = read_number(access, joint.node, objects.RATED_TORQUE, 0)
        if not rated:  # with 0, every torque would read 0, and no overload would be seen
            raise WrongArm(
                f"Joint {number} states no rated torque ({objects.RATED_TORQUE:04X}h), the unit of its torques. Give "
                f"rated_torque_nm for it in the bus profile {profile.name}."
            )
        torques.append(rated * 1e-3)
    return tuple(torques)


def _joint_differences(
    access: ObjectAccess,
    expected: JointDescription,
    drive: JointProfile,
    limits: JointLimits,
    profile: BusProfile,
) -> Iterator[str]:
    node = drive.node
    device = access.read_unsigned(node, objects.DEVICE_TYPE)
    if not profile.is_drive(device):
        yield f"is not a CiA 402 servo drive (1000h = {device:08X}h)"
        return
    yield from _sensor_differences(access, expected.sensor, drive, profile.compared)
    if objects.POSITION_LIMITS in profile.compared:
        lower, upper = (access.read_signed(node, objects.POSITION_LIMITS, sub) for sub in (1, 2))
        if (lower, upper) != (limits.lower_counts, limits.upper_counts):
            expected_range = f"{limits.lower_counts} .. {limits.upper_counts}"
            yield f"has the range {lower} .. {upper} counts, expected {expected_range}"
    if objects.CONTROL_PERIOD in profile.compared:
        digits = access.read_unsigned(node, objects.CONTROL_PERIOD, 1)
        period_s = digits * 10.0 ** access.read_signed(node, objects.CONTROL_PERIOD, 2)
        if abs(period_s - objects.CONTROL_PERIOD_S) > 1e-9:
            required = f"expected {objects.CONTROL_PERIOD_S:g} s"
            yield f"has a control period of {period_s:g} s, {required}"


def _sensor_differences(
    access: ObjectAccess,
    sensor: EncoderDescription | RvdtDescription,
    drive: JointProfile,
    compared: frozenset[int],
) -> Iterator[str]:
    node, is_encoder = drive.node, isinstance(sensor, EncoderDescription)
    if objects.SENSOR in compared:
        expected = SensorKind.ENCODER if is_encoder else SensorKind.RVDT
        if (kind := access.read_unsigned(node, objects.SENSOR, objects.SENSOR_KIND)) != expected:
            name = "encoder" if is_encoder else "RVDT"
            yield f"has sensor kind {kind}, expected {expected:d} ({name})"
            return
    if isinstance(sensor, EncoderDescription):
        if objects.ENCODER_RESOLUTION in compared:
            per_rev = drive.counts_per_rev
            per_rev = sensor.counts_per_rev if per_rev is None else per_rev
            resolution = objects.ENCODER_RESOLUTION
            counts, turns = (access.read_unsigned(node, resolution, sub) for sub in (1, 2))
            if not turns or counts != per_rev * turns:
                per = "turn" if turns == 1 else f"{turns} turns"
                yield f"has an encoder of {counts} counts per {per}, expected {per_rev} per turn"
    elif objects.SENSOR in compared:
        bits = access.read_unsigned(node, objects.SENSOR, objects.SENSOR_BITS)
        full_scale = access.read_unsigned(node, objects.SENSOR, objects.SENSOR_FULL_SCALE)
        if bits != sensor.bits:
            yield f"has a converter of {bits} bits, expected {sensor.bits}"
        if abs(full_scale - sensor.full_scale_microdegrees) > 1:
            yield (
                f"has an RVDT of {full_scale * 1e-6:.6f} deg full scale, expected "
                f"{sensor.full_scale_microdegrees * 1e-6:.6f} deg"
            )
