"""What each sample is checked for: following, dropout, standstill, count continuity, latency."""
