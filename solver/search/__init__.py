"""Starting from nothing known. Knows no noise model."""
