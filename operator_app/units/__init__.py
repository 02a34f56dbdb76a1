"""Numbers as people read them: which unit, how many digits. The lowest room; knows nothing but numbers."""
