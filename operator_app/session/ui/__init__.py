"""Shared by all user interfaces: actions, guards, snapshot, runner."""
