"""Global start: finds parameters without a first guess."""
