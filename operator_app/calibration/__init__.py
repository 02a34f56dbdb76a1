"""Calibrates an arm from poses, gives a verdict, and tests calibrations with later poses."""
