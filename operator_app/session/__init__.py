"""Workflow of a session, independent of the user interface: states, guards, journal, resume."""
