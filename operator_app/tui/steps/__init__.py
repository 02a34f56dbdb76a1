"""One module per step, with its panels; each panel turns a snapshot into lines."""
