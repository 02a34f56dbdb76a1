"""Interfaces for people and scripts: command line, session, terminal app, files."""
