"""Checks on every sample: following, dropout, standstill, count continuity, latency."""
