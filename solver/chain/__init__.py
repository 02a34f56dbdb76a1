"""The open chain: D-H kinematics, arms, sensors and pose sets."""
