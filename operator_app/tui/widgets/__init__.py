"""Panels that several steps share. Each panel turns a snapshot into lines."""
