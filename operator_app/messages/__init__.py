"""Texts of errors and findings."""
