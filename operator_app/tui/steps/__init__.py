"""One module per step: its panels, and their lines for a snapshot."""
