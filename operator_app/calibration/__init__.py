"""From poses to a judged calibration, and what later poses say of it. Knows no session, screen or bus."""
