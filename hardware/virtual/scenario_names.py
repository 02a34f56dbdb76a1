"""What the virtual arms are called; apart, so that a command line knows without loading them."""

SCENARIOS = ("exact", "datasheet", "as_reported", "wild")
DEFAULT_SCENARIO = "datasheet"
