"""Arm descriptions for tests."""

from hardware.arm_description import (
    ArmDescription,
    EncoderDescription,
    JointDescription,
    RvdtDescription,
)


def described(
    model: str,
    *joints: tuple[EncoderDescription | RvdtDescription, float],
    max_speed_rad_per_s: float = 1.0,
    max_torque_nm: float = 50.0,
) -> ArmDescription:
    """An arm of joints with these sensors, and ranges of plus and minus an angle (rad)."""
    return ArmDescription(
        model=model,
        joints=tuple(
            JointDescription(
                name=f"joint {j}",
                lower_rad=-reach_rad,
                upper_rad=reach_rad,
                max_speed_rad_per_s=max_speed_rad_per_s,
                max_torque_nm=max_torque_nm,
                sensor=sensor,
            )
            for j, (sensor, reach_rad) in enumerate(joints, 1)
        ),
    )
