"""The virtual controller: nodes, plant and sensors of an arm that is not there."""

SCENARIOS = ("exact", "datasheet", "as_reported", "wild")
"""Names of the virtual arms; here, so that a command line need not load them."""
DEFAULT_SCENARIO = "datasheet"
