"""Closed loops: how far each pose is from closing, and the derivatives of that."""
