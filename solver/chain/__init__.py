"""The open chain: D-H kinematics, arms, sensors, pose sets."""
