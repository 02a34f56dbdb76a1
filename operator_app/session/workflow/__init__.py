"""The steps of a session on an arm: opening, capture, placements, export, release."""
