"""First contact with an arm: probe, profile draft, bench check, bus monitor."""
