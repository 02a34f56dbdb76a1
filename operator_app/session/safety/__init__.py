"""Checks before and during motion: preflight, resume, closure, sensor faults."""
