"""The simulated arm: controller with CANopen nodes, plant and sensors."""

SCENARIOS = ("exact", "datasheet", "as_reported", "wild")
"""Names of the virtual arms; defined here, so that a command line can list them without loading the arms."""
DEFAULT_SCENARIO = "datasheet"
