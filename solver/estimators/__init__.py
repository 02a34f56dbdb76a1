"""From loops and readings to parameters. Knows no fixture, screen or file."""
