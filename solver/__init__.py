"""Kinematics, closure, estimation and planning. NumPy and SciPy only: no bus, no screen, no file."""
