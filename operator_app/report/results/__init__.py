"""The results of each command, as text and as JSON."""
