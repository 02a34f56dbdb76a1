"""Estimators: parameters from loops and readings."""
