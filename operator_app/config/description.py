"""What the drives of an arm should say of themselves, from its arm file."""

from __future__ import annotations

from hardware.arm_description import (
    ArmDescription,
    EncoderDescription,
    JointDescription,
    RvdtDescription,
)
from operator_app.errors import SessionError
from solver.chain.arm_model import ArmModel
from solver.chain.sensors import Encoder, NoSensor, Rvdt


def describe(arm: ArmModel) -> ArmDescription:
    """Return what the drives of `arm` should say of themselves."""
    return ArmDescription(
        model=arm.name,
        joints=tuple(
            JointDescription(
                name=joint.name,
                lower_rad=joint.lower_rad,
                upper_rad=joint.upper_rad,
                max_speed_rad_per_s=joint.max_speed_rad_per_s,
                max_torque_nm=joint.max_torque_nm,
                sensor=_sensor(joint.name, joint.sensor),
            )
            for joint in arm.joints
        ),
    )


def _sensor(name: str, sensor: Encoder | Rvdt | NoSensor) -> EncoderDescription | RvdtDescription:
    match sensor:
        case Encoder():
            return EncoderDescription(counts_per_rev=sensor.counts_per_rev)
        case Rvdt():
            return RvdtDescription(bits=sensor.bits, full_scale_rad=sensor.full_scale_rad)
        case NoSensor():
            raise SessionError(
                f"joint {name} has no sensor",
                "a joint that is moved needs one; leave its reading out with --unsensed instead",
            )
