"""Checks of commands, samples and nodes: limits, following, dropout, standstill, count continuity, heartbeats."""
