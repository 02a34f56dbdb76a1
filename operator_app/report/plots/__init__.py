"""Plots of a calibration, as SVG and as characters."""
