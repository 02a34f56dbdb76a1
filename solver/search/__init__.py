"""Global start: parameters without a first guess."""
