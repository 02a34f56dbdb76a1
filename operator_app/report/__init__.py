"""Results in words, tables and JSON. Renders what it is given; computes nothing."""
