"""Which joints drive and which poses to take. Knows no session, screen or bus."""
