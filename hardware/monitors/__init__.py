"""Checks of samples and nodes: following, dropout, standstill, count continuity, heartbeats, other masters."""
