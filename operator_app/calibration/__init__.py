"""From poses to a judged calibration, and what later poses say of it."""
