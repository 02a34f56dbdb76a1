"""Results as text, tables and JSON. This package renders; it computes nothing."""
