"""The session driven by a procedure file instead of a person."""
