"""Global start: parameters from nothing known."""
