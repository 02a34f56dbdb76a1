"""Canopen."""
