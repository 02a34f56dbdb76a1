"""Results as text, tables and JSON. Renders only; computes nothing."""
