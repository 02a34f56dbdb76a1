"""From poses to a calibration with its verdict, and its tests with later poses."""
