"""Panels that several steps share. Each turns a snapshot into lines."""
