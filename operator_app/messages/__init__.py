"""Errors and findings in words for people."""
