"""The simulated arm: controller with CANopen nodes, plant and sensors."""

SCENARIOS = ("exact", "datasheet", "as_reported", "wild")
"""Names of the virtual arms; here, so that a command line need not load them."""
DEFAULT_SCENARIO = "datasheet"
