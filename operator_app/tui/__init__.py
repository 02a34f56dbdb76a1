"""The terminal app: display and keys. All decisions are made by the session."""
