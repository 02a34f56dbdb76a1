"""Closed loops: closure error of each pose, and its derivatives."""
