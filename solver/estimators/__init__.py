"""From loops and readings to parameters."""
