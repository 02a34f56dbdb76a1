"""The terminal app: what an operator sees and presses. Everything it decides is decided by the session."""
