"""Commissioning of an arm: probe, profile draft, bench check, bus monitor."""
